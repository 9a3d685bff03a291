"""The one door through which files leave: whole or not at all, and never over other people's files.

Every file that Trocar writes says what it is: a mark in it, ``made by Trocar: KIND``. A file is replaced only by one of
its own kind; any other file of that name stays, and the user is told.
"""

from __future__ import annotations

import csv
import errno
import json
import os
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import StringIO
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trocar.drafts import drafted
from trocar.errors import MachineError, TrocarError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MADE_BY = "made_by"
"""Key of the mark in JSON files."""

PICTURE = "picture"
PICTURES = (".png", ".svg", ".pdf")

NO_NAME = (errno.ENAMETOOLONG, errno.ELOOP, errno.EINVAL)
"""What systems answer where a name can be no file's: it is too long, leads in a circle, or has forbidden characters."""

SEARCHED_BYTES = 64 << 10
"""A mark is looked for in so much of a file's beginning and of its end."""

COMMENTS: dict[str, Callable[[str], str]] = {
    ".html": "<!-- {} -->\n".format,
    ".toml": "# {}\n".format,
    ".urdf": "<!-- {} -->\n".format,
    ".xml": "<!-- {} -->\n".format,
}
"""The mark of a text file, in a comment at its end."""


def mark_of(kind: str) -> str:
    """Return the mark of a kind of files, such as ``plan of sutures``."""
    return f"made by Trocar: {kind}"


def blame(error: OSError) -> type[TrocarError]:
    """Return whose error it is that a file cannot be opened: the input's, which names none, or the machine's."""
    named_none = isinstance(error, FileNotFoundError | NotADirectoryError | IsADirectoryError)
    return TrocarError if named_none or error.errno in NO_NAME else MachineError


def make_folder(path: str | Path) -> Path:
    """Make a folder and those above it, where they are not there yet, and return its path.

    Raises:
        TrocarError: there is a file in its place, or in that of a folder above it.
        MachineError: it cannot be made.
    """
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise TrocarError(f"{str(path)!r} is a file where a folder is to be; give another") from None
    except OSError as error:
        raise blame(error)(f"folder {str(path)!r} cannot be made ({error.strerror}); give another") from None
    return Path(path)


def bears(path: str | Path, mark: str) -> bool:
    """Return whether a file bears a mark; an empty one, as a full disk leaves it, is anybody's."""
    with Path(path).open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        begin = file.read(SEARCHED_BYTES)
        file.seek(max(0, size - SEARCHED_BYTES))
        return size == 0 or any(mark.encode() in part for part in (begin, file.read()))


def require_place(path: str | Path, kind: str, inputs: Sequence[str | Path] = (), mark: str = "") -> Path:
    """Return a path to which a file may be written: ask before a long computation.

    Args:
        path: of the file; its folder need not be there yet.
        kind: of the file.
        inputs: files that are read; they are never written to, of whatever kind they are.
        mark: of its kind, where that is not ``mark_of(kind)``.

    Raises:
        TrocarError: there is something else already.
        MachineError: this cannot be found out.
    """
    path = Path(path)
    try:
        if any(Path(other).exists() and path.exists() and path.samefile(other) for other in inputs):
            raise TrocarError(f"{str(path)!r} is read, and what is written would replace it; give another name")
        if path.is_dir():
            raise TrocarError(f"{str(path)!r} is a folder where a file is to be; give another name or folder")
        if path.exists() and not bears(path, mark or mark_of(kind)):
            raise TrocarError(
                f"{str(path)!r} already exists and is not a {kind} that Trocar wrote, so it is not replaced; "
                "give another name or folder, or move it away"
            )
    except OSError as error:
        raise blame(error)(f"cannot look at {str(path)!r} ({error.strerror}); give another name or folder") from None
    return path


@contextmanager
def writing(path: str | Path, kind: str, mark: str = "") -> Iterator[Path]:
    """Yield a draft to write to, and move it to a file's place when the block ends without an error.

    Whatever goes wrong, the file that was there stays as it was, and no draft is left behind; that of a process that
    was killed is removed by the next one that writes into the folder.

    Args:
        path: of the file.
        kind: of the file.
        mark: of its kind, where that is not ``mark_of(kind)``; whoever writes the draft puts it there.

    Raises:
        TrocarError: there is something else already.
        MachineError: it cannot be written.
    """
    path = require_place(path, kind, mark=mark)
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


def write_json(path: str | Path, values: Mapping[str, Any], kind: str) -> Path:
    """Write a JSON file, its mark under ``made_by``, and return its path; raises as ``writing`` does."""
    path = Path(path)
    text = json.dumps({MADE_BY: mark_of(kind), **values}, indent=1, allow_nan=False)
    with writing(path, kind) as draft:
        draft.write_text(text + "\n", encoding="utf-8")
    return path


def write_table(path: str | Path, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> Path:
    """Write a CSV file, cells quoted where they must be, and return its path; raises as ``writing`` does.

    It has no place for a mark: one with the same columns is of its kind.
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
    """Return the path of a picture to which one may be written: ask before a long computation.

    Raises:
        TrocarError: it is no picture's name, or there is something else already.
        MachineError: this cannot be found out.
    """
    path = Path(path)
    if path.suffix.lower() not in PICTURES:
        raise TrocarError(f"picture {str(path)!r} must end in {', '.join(PICTURES)}; choose another name")
    if not path.parent.is_dir():
        raise TrocarError(f"cannot write {str(path)!r} (No such file or directory); choose another folder")
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
