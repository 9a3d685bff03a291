"""The declared measurements, each a command and what is kept of its output, and their records."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from trocar.errors import TrocarError
from trocar.files.output import write_json

FOLDER = Path("docs/figures")
MEASURED, TABLES = FOLDER / "measured", FOLDER / "tables"
"""Folders of the records and of the tables' templates, below the root."""


@dataclass(frozen=True)
class Measurement:
    """One command whose output appears in the docs.

    Attributes:
        name: name of its record, and of its values in the tables' templates.
        command: as a reader would type it.
        sources: files and folders that its figures depend on, or names of groups of them; ``!`` excludes one.
        minutes: how long it takes on one core, roughly.
        run_with: added to the command when it runs; ``{folder}``: folder kept between runs, ``{jobs}``: processes.
        keep: what is kept of the printed JSON object: dotted paths, ``*`` for any step, or names of groups of paths.
        index: lists in that object that become objects: name of the list to the key that names its members.
        find: what is kept of the printed text: name to regular expression; the groups of all its matches are kept.
        alone: whether it compares speeds, and therefore runs while nothing else does.
    """

    name: str
    command: str
    sources: tuple[str, ...]
    minutes: float
    run_with: str = ""
    keep: tuple[str, ...] = ()
    index: Mapping[str, str] = field(default_factory=dict)
    find: Mapping[str, str] = field(default_factory=dict)
    alone: bool = False


@dataclass(frozen=True)
class Record:
    """The result of a measurement.

    Attributes:
        command: the command that was run.
        commit: commit of the code.
        values: kept values, as in JSON.
        date: day of the measurement.
        digest: digest of the sources then (``source_age``).
        older: whether the code had changed when the pages were last written.
        trials: digests of the trials of the first sessions, by their paths.
        same_at: commit of later code that made the same trials in these sessions; empty: none.
    """

    command: str
    commit: str
    values: Mapping[str, Any]
    date: str
    digest: str
    older: bool = False
    trials: Mapping[str, str] = field(default_factory=dict)
    same_at: str = ""


def read_measurements(root: Path) -> dict[str, Measurement]:
    """Return all measurements that the TOML files of the folder declare, with groups of sources and values put in.

    Raises:
        TrocarError: a file is damaged, a key unknown or missing, or a name taken twice.
    """
    files = {path: _toml(path) for path in sorted((root / FOLDER).glob("*.toml"))}
    sources: dict[str, list[str]] = {}
    kept: dict[str, list[str]] = {}
    for content in files.values():
        sources |= content.get("sources", {})
        kept |= content.get("kept", {})
    found: dict[str, Measurement] = {}
    for path, content in files.items():
        for name, given in content.get("measured", {}).items():
            if name in found:
                raise TrocarError(f"measurement {name!r} of {str(path)!r} is declared twice; rename one of them")
            try:
                lists = {
                    "sources": _spread(given.pop("sources"), sources),
                    "keep": _spread(given.pop("keep", []), kept),
                }
                found[name] = Measurement(name=name, **{key: tuple(value) for key, value in lists.items()}, **given)
            except (TypeError, KeyError) as error:
                known = ", ".join(f.name for f in fields(Measurement))
                raise TrocarError(f"measurement {name!r} of {str(path)!r}: {error}; keys are {known}") from None
    return found


def read_record(root: Path, name: str) -> Record | None:
    """Return the last record of a measurement; None if there is none.

    Raises:
        TrocarError: the file is damaged.
    """
    path = root / MEASURED / f"{name}.json"
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return Record(**{key: value for key, value in content.items() if key != "made_by"})
    except (ValueError, TypeError) as error:
        raise TrocarError(f"record {str(path)!r} is damaged ({error}); measure {name} again") from None


def write_record(root: Path, name: str, record: Record) -> None:
    """Write the record of a measurement, in place of the one before."""
    path = root / MEASURED / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, asdict(record), "figure")


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise TrocarError(f"{str(path)!r} is no TOML ({error})") from None


def _spread(names: Sequence[str], groups: Mapping[str, Sequence[str]]) -> list[str]:
    """Return paths, with the names of groups replaced by their members."""
    return [path for name in names for path in (_spread(groups[name], groups) if name in groups else [name])]
