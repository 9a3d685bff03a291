"""Tables of the pages: templates filled with what was measured, between markers in README.md and docs/*.md."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, TemplateError, meta

from declared_figures import TABLES, Measurement, Record
from trocar.errors import TrocarError

BLOCK = re.compile(r"(<!-- figures: (\S+) -->\n)(.*?)(<!-- /figures -->)", re.DOTALL)
"""A table in a page: its begin with its name, what stands there, its end."""

MACHINE_MARK = "†"


class OfMachine(float):
    """A number that another machine would not give; wherever it is shown it bears a mark."""


class Tables:
    """The templates, and the pages in which they stand.

    Args:
        root: of the repository.
        measurements: by name.
        records: by name, of those that were measured.
    """

    def __init__(self, root: Path, measurements: Mapping[str, Measurement], records: Mapping[str, Record]):
        self.root, self.records = root, records
        self.pages = [root / "README.md", *sorted((root / "docs").glob("*.md"))]
        self._values = {name: _seen(record, measurements[name]) for name, record in records.items()}
        self._jinja = Environment(
            loader=FileSystemLoader(root / TABLES), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
        )
        self._jinja.filters |= {"fixed": fixed, "bare": bare, "percent": percent, "spread": spread}

    def names(self, page: Path) -> list[str]:
        """Return the tables that a page has."""
        return [name for _, name, _, _ in BLOCK.findall(page.read_text(encoding="utf-8"))]

    def measurements_in(self, name: str) -> list[str]:
        """Return the measurements that a table is made of."""
        try:
            text = (self.root / TABLES / f"{name}.md.j2").read_text(encoding="utf-8")
            return sorted(meta.find_undeclared_variables(self._jinja.parse(text)))
        except FileNotFoundError:
            raise TrocarError(f"table {name!r} has no template {TABLES / name}.md.j2") from None
        except TemplateError as error:
            raise TrocarError(f"template of table {name!r}: {error}") from None

    def table(self, name: str) -> str:
        """Return a table as it is to stand in a page.

        Raises:
            TrocarError: it has no template, or speaks of what was not measured.
        """
        used = self.measurements_in(name)
        missing = [each for each in used if each not in self._values]
        if missing:
            raise TrocarError(f"table {name!r}: {missing[0]} was never measured; python tools/figures.py measure it")
        try:
            text = self._jinja.get_template(f"{name}.md.j2").render(self._values).strip("\n")
        except TemplateError as error:
            raise TrocarError(f"template of table {name!r}: {error}") from None
        if MACHINE_MARK in text:
            machines = dict.fromkeys(self.records[each].machine for each in used if self.records[each].machine)
            text += f"\n\n{MACHINE_MARK} depends on the machine: {'; '.join(machines) or 'which one was not noted'}."
        return text

    def rendered(self, page: Path) -> tuple[str, list[str]]:
        """Return a page's text with its tables made anew, and why some stay as they are."""
        wrong = []

        def made(found: re.Match[str]) -> str:
            try:
                return f"{found[1]}\n{self.table(found[2])}\n\n{found[4]}"
            except TrocarError as error:
                wrong.append(str(error))
                return found[0]

        return BLOCK.sub(made, page.read_text(encoding="utf-8")), wrong

    def write(self) -> tuple[list[Path], list[str]]:
        """Write the tables into the pages; return pages that have changed, and why tables stay as they were."""
        changed, wrong = [], []
        for page in self.pages:
            text, problems = self.rendered(page)
            wrong += problems
            if text != page.read_text(encoding="utf-8"):
                page.write_text(text, encoding="utf-8")
                changed.append(page)
        return changed, wrong


def fixed(value: float, digits: int = 0) -> str:
    """Return a number with so many digits behind the point."""
    return f"{value:.{digits}f}" + _mark(value)


def bare(value: float, digits: int) -> str:
    """Return the same without a zero before the point; 0 where nothing is left."""
    text = f"{value:.{digits}f}"
    return ("0" if float(text) == 0 else re.sub(r"^(-?)0\.", r"\1.", text)) + _mark(value)


def percent(value: float, digits: int = 1) -> str:
    """Return a share in percent; whole numbers without a fraction."""
    return re.sub(r"\.0+$", "", f"{100 * value:.{digits}f}") + _mark(value)


def spread(estimate: Mapping[str, float], digits: int) -> str:
    """Return an estimate with half of its interval: 3.42 ± 0.01."""
    half = 0.5 * (estimate["high"] - estimate["low"])
    return f"{estimate['mean']:.{digits}f} ± {half:.{digits}f}" + _mark(estimate["mean"])


def _mark(value: float) -> str:
    return MACHINE_MARK if isinstance(value, OfMachine) else ""


def _seen(record: Record, measurement: Measurement) -> dict[str, Any]:
    """Return what a template sees of a record: its values, and ``command``, ``commit`` and ``origin``."""
    values = {key: _marked(value, (key,), measurement.machine) for key, value in record.values.items()}
    return values | {"command": record.command, "commit": record.commit, "origin": record.origin}


def _marked(value: Any, place: tuple[str, ...], machine: Sequence[str]) -> Any:
    if isinstance(value, dict):
        return {key: _marked(inner, (*place, key), machine) for key, inner in value.items()}
    if isinstance(value, list):
        return [_marked(inner, (*place, str(k)), machine) for k, inner in enumerate(value)]
    of_machine = any(place[: len(path)] == path for path in (tuple(one.split(".")) for one in machine))
    return OfMachine(value) if of_machine and isinstance(value, int | float) else value
