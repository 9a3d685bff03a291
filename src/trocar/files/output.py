"""Writing of files: completely or not at all, and never over other people's files.

Every file that Trocar writes carries a mark, ``made by Trocar: KIND``. A file is replaced only by one of the same kind;
any other file of that name stays, and the user is told.
"""

from __future__ import annotations

import csv
import errno
import itertools
import json
import os
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from io import StringIO
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trocar.errors import BadFile, InvalidInput, MachineError, TrocarError

try:
    import fcntl
except ImportError:  # Windows: drafts of killed processes stay
    fcntl = None

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MADE_BY = "made_by"
"""Key of the mark in JSON files."""

PICTURE = "picture"
PICTURES = (".png", ".svg", ".pdf")

NO_NAME = (errno.ENAMETOOLONG, errno.ELOOP, errno.EINVAL)
"""Error codes of names that no file can have: too long, a loop of links, or forbidden characters."""

SEARCHED_BYTES = 64 << 10
"""A mark is searched for in this many bytes at a file's beginning and at its end."""

DRAFT = re.compile(r"\.trocar-\d+-\d+\.part(\.\w+)?")
"""Names of drafts, with the numbers of the process and of the draft."""
_NUMBERS = itertools.count()

_XML = "<!-- {} -->\n".format
COMMENTS = {".html": _XML, ".md": _XML, ".urdf": _XML, ".xml": _XML, ".toml": "# {}\n".format}
"""The mark of a text file, in a comment at its end."""


def mark_of(kind: str) -> str:
    """Return the mark of a kind of files, such as ``plan of sutures``."""
    return f"made by Trocar: {kind}"


def blame(error: OSError) -> type[TrocarError]:
    """Return the type of error for a file that cannot be opened: the input's if its name is bad, or the machine's."""
    named_none = isinstance(error, FileNotFoundError | NotADirectoryError | IsADirectoryError)
    return TrocarError if named_none or error.errno in NO_NAME else MachineError


def make_folder(path: str | Path) -> Path:
    """Make a folder, and its parents if they do not exist, and return its path.

    Raises:
        TrocarError: there is a file in its place, or in that of a parent.
        MachineError: it cannot be made.
    """
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise BadFile(path, "is a file where a folder is to be", "give another") from None
    except OSError as error:
        raise blame(error)(f"folder {str(path)!r} cannot be made ({error.strerror}); give another") from None
    return Path(path)


def bears(path: str | Path, mark: str) -> bool:
    """Return whether a file carries a mark; an empty file, as a full disk leaves it, counts as carrying any."""
    with Path(path).open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        begin = file.read(SEARCHED_BYTES)
        file.seek(max(0, size - SEARCHED_BYTES))
        return size == 0 or any(mark.encode() in part for part in (begin, file.read()))


def require_place(path: str | Path, kind: str, inputs: Sequence[str | Path] = (), mark: str = "") -> Path:
    """Return a path to which a file may be written; check this before a long computation.

    Args:
        path: of the file; its folder need not exist yet.
        kind: of the file.
        inputs: files that are read; they are never written to, whatever their kind.
        mark: of its kind, if not ``mark_of(kind)``.

    Raises:
        TrocarError: something else is already there.
        MachineError: this cannot be determined.
    """
    path = Path(path)
    try:
        if any(Path(other).exists() and path.exists() and path.samefile(other) for other in inputs):
            raise BadFile(path, "is read, and what is written would replace it", "give another name")
        if path.is_dir():
            raise BadFile(path, "is a folder where a file is to be", "give another name or folder")
        if path.exists() and not bears(path, mark or mark_of(kind)):
            problem = f"is not a {kind} that Trocar wrote, so it is not replaced"
            remedy = "give another name or folder, or move it away"
            raise InvalidInput(f"{str(path)!r} already exists and", problem, remedy)
    except OSError as error:
        raise blame(error)(f"cannot look at {str(path)!r} ({error.strerror}); give another name or folder") from None
    return path


@contextmanager
def drafted(path: str | Path) -> Iterator[Path]:
    """Yield an empty draft beside a file that is to be written, and remove it unless it has become that file.

    Drafts in the same folder whose process was killed are removed first. A lock distinguishes them from those still
    being written, even across machines or containers, where process ids mean nothing. The system frees the lock of a
    process that ends, however it ends.

    Raises:
        OSError: the folder does not exist, is full, or is not writable.
    """
    path = Path(path)
    clear_drafts(path.parent)
    draft, handle = _locked_draft(path)
    while not _is_at(draft, handle):  # before it was locked, another process took it for abandoned
        os.close(handle)
        draft, handle = _locked_draft(path)
    if fcntl is None:
        os.close(handle)  # on Windows, an open file cannot be renamed
    try:
        yield draft
    finally:
        draft.unlink(missing_ok=True)
        if fcntl is not None:
            os.close(handle)


def _locked_draft(path: Path) -> tuple[Path, int]:
    """Make an empty draft beside a file; return its path and its open handle, locked if possible."""
    draft = path.with_name(f".trocar-{os.getpid()}-{next(_NUMBERS)}.part{path.suffix}")
    handle = os.open(draft, os.O_CREAT | os.O_RDWR, 0o666)
    if fcntl is not None:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_SH)
    return draft, handle


def _is_at(path: Path, handle: int) -> bool:
    """Return whether an open file is still the one of this name."""
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False


def clear_drafts(folder: str | Path) -> None:
    """Remove the drafts that killed processes left in a folder, where locks can tell; nothing else is touched."""
    if fcntl is None:
        return
    entries: list[os.DirEntry[str]] = []
    with suppress(OSError):  # a folder that does not exist, or is writable but not readable
        entries = [entry for entry in os.scandir(folder) if DRAFT.fullmatch(entry.name)]
    for entry in entries:
        with suppress(OSError):  # another process is writing it or has removed it, or it is not ours to remove
            handle = os.open(entry.path, os.O_RDWR)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.unlink(entry.path)
            finally:
                os.close(handle)


@contextmanager
def writing(path: str | Path, kind: str, mark: str = "") -> Iterator[Path]:
    """Yield a draft to write to, and move it to a file's place when the block ends without an error.

    Whatever goes wrong, the existing file stays as it was, and no draft is left behind; the draft of a killed process
    is removed by the next one that writes into the folder.

    Args:
        path: of the file.
        kind: of the file.
        mark: of its kind, if not ``mark_of(kind)``; the caller writes it into the draft.

    Raises:
        TrocarError: something else is already there.
        MachineError: it cannot be written.
    """
    with replacing(require_place(path, kind, mark=mark)) as draft:
        yield draft


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Do as :func:`writing`, for a file without a mark, in a folder that another file's mark shows to be Trocar's."""
    path = Path(path)
    try:
        with drafted(path) as draft:
            yield draft
            draft.replace(path)
    except OSError as error:
        raise blame(error)(f"cannot write {str(path)!r} ({error.strerror or error}); choose another folder") from None


def write_text(path: str | Path, text: str, kind: str) -> Path:
    """Write an HTML, XML or TOML file, its mark in a comment, and return its path; raises as ``writing`` does."""
    path = Path(path)
    with writing(path, kind) as draft:
        draft.write_text(text + COMMENTS[path.suffix](mark_of(kind)), encoding="utf-8")
    return path


def jsonable(value: object) -> Any:
    """Return a NumPy number or array as JSON can hold it; the ``default`` of ``json.dumps`` (TypeError: it is none)."""
    import numpy as np  # takes a while, which commands that only print help avoid

    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{value!r} is no value of JSON")


def write_json(path: str | Path, values: Mapping[str, Any], kind: str) -> Path:
    """Write a JSON file, its mark under ``made_by``, and return its path; raises as ``writing`` does."""
    path = Path(path)
    text = json.dumps({MADE_BY: mark_of(kind), **values}, indent=1, allow_nan=False, default=jsonable)
    with writing(path, kind) as draft:
        draft.write_text(text + "\n", encoding="utf-8")
    return path


def write_table(path: str | Path, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> Path:
    """Write a CSV file, cells quoted where they must be, and return its path; raises as ``writing`` does.

    A CSV file has no place for a mark: one with the same columns counts as the same kind.
    """
    path, head = Path(path), StringIO()
    csv.writer(head, lineterminator="\n").writerow(columns)
    with (
        writing(path, "table with these columns", mark=head.getvalue()) as draft,
        draft.open("w", newline="", encoding="utf-8") as file,
    ):
        csv.writer(file, lineterminator="\n").writerows(chain([columns], rows))
    return path


def require_picture(path: str | Path) -> Path:
    """Return a path to which a picture may be written; check this before a long computation.

    Raises:
        TrocarError: it is not the name of a picture, or something else is already there.
        MachineError: this cannot be determined.
    """
    path = Path(path)
    if path.suffix.lower() not in PICTURES:
        raise BadFile(path, f"must end in {', '.join(PICTURES)}", "choose another name", kind="picture")
    if not path.parent.is_dir():
        raise BadFile(path, "(No such file or directory)", "choose another folder", kind="cannot write")
    return require_place(path, PICTURE)


def write_figure(path: str | Path, figure: Figure, **options: Any) -> Path:
    """Write a Matplotlib figure as a picture and return its path; raises as ``writing`` does.

    Args:
        path: ends in ``.png``, ``.svg`` or ``.pdf``.
        figure: to be drawn.
        options: of ``Figure.savefig``.
    """
    path = require_picture(path)
    key = "Software" if path.suffix.lower() == ".png" else "Creator"
    with writing(path, PICTURE) as draft:
        figure.savefig(draft, metadata={key: mark_of(PICTURE)}, **options)
    return path


def mark_zip(path: str | Path, kind: str) -> None:
    """Put the mark into a zip's comment."""
    with zipfile.ZipFile(path, "a") as file:
        file.comment = mark_of(kind).encode()
