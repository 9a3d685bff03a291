"""``--out DIR``: whether it can be written, asked before anything long is computed."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from trocar.errors import TrocarError


def check_out_folder(out: Path | None, names: Iterable[str]) -> None:
    """Raise a sentence unless files of these names can be written into a folder, which may not be there yet.

    A folder that is not there is made and removed again: nothing but trying tells.
    """
    if out is None:
        return
    try:
        if out.exists() and not out.is_dir():
            raise TrocarError(f"--out {str(out)!r} is a file; give a folder")
        missing = [folder for folder in (out, *out.parents) if not folder.exists()]
        out.mkdir(parents=True, exist_ok=True)
        may_write = os.access(out, os.W_OK | os.X_OK)
        for folder in missing:
            folder.rmdir()
        in_the_way = [out / name for name in names if not missing and not _can_be_written(out / name)]
    except OSError as error:
        raise TrocarError(f"--out {str(out)!r} cannot be made ({error.strerror}); give another folder") from None
    if not may_write:
        raise TrocarError(f"--out {str(out)!r} cannot be written into; give another folder")
    if in_the_way:
        raise TrocarError(
            f"--out {str(out)!r} holds {in_the_way[0].name!r}, which cannot be overwritten; give another folder"
        )


def _can_be_written(path: Path) -> bool:
    """Return whether a file can be written where this one may be already."""
    return not path.exists() or (path.is_file() and os.access(path, os.W_OK))


def check_npz(path: Path, what: str) -> None:
    """Raise TrocarError if a file that is to be written cannot be: ask before a long computation."""
    if path.suffix != ".npz" or not path.parent.is_dir():
        raise TrocarError(f"{what} file {str(path)!r} must end in .npz and lie in a folder that exists")
