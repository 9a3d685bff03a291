"""Where a command writes its files: the default folder, and a check before computing that they can be written."""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from trocar.errors import BadFile, MachineError
from trocar.files.output import blame, require_place

LONGEST_PART, LONGEST_NAME = 40, 150
"""Maximum length of a value in a folder's name, and of the whole name; longer ones end in a digest."""


def default_folder(name: str, unusual: Mapping[str, Any]) -> Path:
    """Return the default folder of a command: ``out/NAME`` and the options that differ from their defaults.

    So different commands do not write to the same folder.

    Args:
        name: name of what is run, with its seed.
        unusual: values of the options that differ from their defaults.
    """
    full = "-".join([name, *(_part(option, value) for option, value in unusual.items())])
    return Path("out") / (full if len(full) <= LONGEST_NAME else f"{full[:LONGEST_NAME]}.{_digest(full)}")


def differing(command: Callable[..., Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the given values that differ from the defaults of a command's parameters."""
    usual = inspect.signature(command).parameters
    return {name: value for name, value in given.items() if value != usual[name].default}


def _part(option: str, value: Any) -> str:
    """Return an option as part of a folder's name; a digest for what a name cannot show, such as a file's content."""
    option = option.replace("_", "-")
    if value is True:
        return option
    named = [_named(one) for one in (value if isinstance(value, list | tuple) else [value])]
    text = "-".join(name for name, _ in named)
    shown = re.sub(r"[^A-Za-z0-9._=]+", "-", text)[:LONGEST_PART].strip("-")
    told = shown == text and not any(content for _, content in named)
    return f"{option}-{shown}" if told else f"{option}-{shown}.{_digest(repr(named))}"


def _named(value: Any) -> tuple[str, str]:
    """Return a name for a value, and its content if the name does not identify it."""
    if isinstance(value, dict):
        return "", json.dumps(value, sort_keys=True)
    if isinstance(value, str | Path) and Path(value).suffix and Path(value).is_file():
        return Path(value).stem, _digest(Path(value).read_bytes())
    return str(value), ""


def _digest(content: str | bytes) -> str:
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()[:8]


def check_out_folder(
    out: Path | None, files: Mapping[str, str], inputs: Sequence[str | Path] = (), option: str = "--out"
) -> None:
    """Raise unless files can be written into a folder, which need not exist yet.

    A folder that does not exist is made and removed again, since only trying tells.

    Args:
        out: the folder; None: nothing will be written.
        files: kind of each file by its name.
        inputs: files that are read.
        option: that names the folder.
    """
    if out is None:
        return
    try:
        if out.exists() and not out.is_dir():
            raise BadFile(out, "is a file", "give a folder", kind=option)
        missing = [folder for folder in (out, *out.parents) if not folder.exists()]
        out.mkdir(parents=True, exist_ok=True)
        may_write = os.access(out, os.W_OK | os.X_OK)
        for folder in missing:
            folder.rmdir()
    except OSError as error:
        raise blame(error)(f"{option} {str(out)!r} cannot be made ({error.strerror}); give another folder") from None
    if not may_write:
        raise MachineError(f"{option} {str(out)!r} cannot be written into; give another folder")
    for name, kind in files.items():
        require_place(out / name, kind, inputs)


def require_file(
    option: str, path: Path, kind: str, suffixes: Sequence[str], inputs: Sequence[str | Path] = (), mark: str = ""
) -> None:
    """Raise unless an option's file has one of these suffixes and can be written without replacing another kind.

    ``inputs`` are files that are read, and ``mark`` is the kind's mark if not the usual one, as in ``require_place``.
    """
    if path.suffix not in suffixes or not path.parent.is_dir():
        problem = f"must end in {', '.join(suffixes)} and lie in a folder that exists"
        raise BadFile(path, problem, "choose another name", kind=f"{option}: file")
    require_place(path, kind, inputs, mark)
