"""Where files of a command go: whether they can be written, asked before anything long is computed."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from trocar.errors import MachineError, TrocarError
from trocar.output import blame, require_place


def check_out_folder(out: Path | None, files: Mapping[str, str], inputs: Sequence[str | Path] = ()) -> None:
    """Raise a sentence unless files can be written into a folder, which may not be there yet.

    A folder that is not there is made and removed again: nothing but trying tells.

    Args:
        out: the folder; None: nothing will be written.
        files: kind of each file by its name.
        inputs: files that are read.
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
    except OSError as error:
        raise blame(error)(f"--out {str(out)!r} cannot be made ({error.strerror}); give another folder") from None
    if not may_write:
        raise MachineError(f"--out {str(out)!r} cannot be written into; give another folder")
    for name, kind in files.items():
        require_place(out / name, kind, inputs)


def check_npz(path: Path, kind: str, inputs: Sequence[str | Path] = ()) -> None:
    """Raise a sentence unless a file can be written: ask before a long computation.

    Args:
        path: of the file.
        kind: of the file.
        inputs: files that are read.
    """
    if path.suffix != ".npz" or not path.parent.is_dir():
        raise TrocarError(f"file {str(path)!r}, a {kind}, must end in .npz and lie in a folder that exists")
    require_place(path, kind, inputs)
