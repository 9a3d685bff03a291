"""Drafts of files: whoever writes one holds a lock on it, so that what a killed process left behind can be told."""

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
    """Give an empty draft beside a file that is to be written, and remove it where it has not become that file.

    Drafts in the same folder whose process was killed are removed first. A lock tells them from those still being
    written, also where processes of several machines or containers write, whose numbers mean nothing to each other. The
    system frees the lock of a process that ends, however it ends.

    Raises:
        OSError: the folder is not there, is full, or may not be written into.
    """
    path = Path(path)
    clear_drafts(path.parent)
    draft = path.with_name(f".trocar-{os.getpid()}-{next(_NUMBERS)}.part{path.suffix}")
    handle = os.open(draft, os.O_CREAT | os.O_RDWR, 0o666)
    try:
        if fcntl is None:
            os.close(handle)  # there, a file that is open cannot take another name
        else:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(handle, fcntl.LOCK_SH)
        yield draft
    finally:
        draft.unlink(missing_ok=True)
        if fcntl is not None:
            os.close(handle)


def clear_drafts(folder: str | Path) -> None:
    """Remove the drafts that killed processes left in a folder, where that can be told; nothing else is touched."""
    if fcntl is None:
        return
    entries: list[os.DirEntry[str]] = []
    with suppress(OSError):  # a folder that is not there, or may be written into but not looked into
        entries = [entry for entry in os.scandir(folder) if _NAME.fullmatch(entry.name)]
    for entry in entries:
        with suppress(OSError):  # somebody writes it, has removed it, or it is not ours to remove
            handle = os.open(entry.path, os.O_RDWR)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.unlink(entry.path)
            finally:
                os.close(handle)
