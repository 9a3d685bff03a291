"""Drafts of files. Their writer holds a lock, so that drafts of killed processes can be recognised."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: drafts of killed processes stay
    fcntl = None

_NAME = re.compile(r"\.trocar-\d+-\d+\.part(\.\w+)?")
_NUMBERS = itertools.count()


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
    draft = path.with_name(f".trocar-{os.getpid()}-{next(_NUMBERS)}.part{path.suffix}")
    handle = os.open(draft, os.O_CREAT | os.O_RDWR, 0o666)
    try:
        if fcntl is None:
            os.close(handle)  # on Windows, an open file cannot be renamed
        else:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(handle, fcntl.LOCK_SH)
        yield draft
    finally:
        draft.unlink(missing_ok=True)
        if fcntl is not None:
            os.close(handle)


def clear_drafts(folder: str | Path) -> None:
    """Remove the drafts that killed processes left in a folder, where locks can tell; nothing else is touched."""
    if fcntl is None:
        return
    entries: list[os.DirEntry[str]] = []
    with suppress(OSError):  # a folder that does not exist, or is writable but not readable
        entries = [entry for entry in os.scandir(folder) if _NAME.fullmatch(entry.name)]
    for entry in entries:
        with suppress(OSError):  # another process is writing it or has removed it, or it is not ours to remove
            handle = os.open(entry.path, os.O_RDWR)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.unlink(entry.path)
            finally:
                os.close(handle)
