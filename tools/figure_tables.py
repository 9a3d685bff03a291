"""Tables of the pages: templates filled with what was measured, between markers in README.md and docs/*.md."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, TemplateError, meta

from declared_figures import TABLES, Measurement, Record
from trocar.errors import TrocarError

BLOCK = re.compile(r"(<!-- figures: (\S+) -->\n)(.*?)(<!-- /figures -->)", re.DOTALL)
"""A table in a page: start marker with the table's name, content, end marker."""


class Tables:
    """The templates, and the pages in which they stand.

    Args:
        root: root of the repository.
        measurements: all measurements by name.
        records: records by name of measurement, as far as there are any.
    """

    def __init__(self, root: Path, measurements: Mapping[str, Measurement], records: Mapping[str, Record]):
        self.root = root
        self.pages = [root / "README.md", *sorted((root / "docs").glob("*.md"))]
        self._values = {name: _seen(each, records.get(name)) for name, each in measurements.items()}
        self._jinja = Environment(
            loader=FileSystemLoader(root / TABLES), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
        )
        self._jinja.filters |= {"fixed": fixed, "bare": bare, "percent": percent}

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
        """Return a table as a page should have it or, if a figure is missing, which commands must be run.

        Raises:
            TrocarError: it has no template, or names something that no measurement has.
        """
        used = self.measurements_in(name)
        unknown = [each for each in used if each not in self._values]
        if unknown:
            raise TrocarError(f"table {name!r}: there is no measurement {unknown[0]!r} in docs/figures/*.toml")
        missing = [self._values[each]["command"] for each in used if not self._values[each]["commit"]]
        try:
            return self._jinja.get_template(f"{name}.md.j2").render(self._values).strip("\n")
        except (TemplateError, TypeError) as error:  # TypeError: a filter got an undefined value
            if missing:
                return f"Not measured yet: `{'`, `'.join(missing)}`"
            raise TrocarError(f"template of table {name!r}: {error}") from None

    def rendered(self, page: Path) -> tuple[str, list[str]]:
        """Return a page's text with its tables made anew, and why some tables stay as they are."""
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
    """Return a number with this many decimals."""
    return f"{value:.{digits}f}"


def bare(value: float, digits: int) -> str:
    """Return a number with this many decimals, without a zero before the point; 0 if it rounds to zero."""
    text = f"{value:.{digits}f}"
    return "0" if float(text) == 0 else re.sub(r"^(-?)0\.", r"\1.", text)


def percent(value: float, digits: int = 1) -> str:
    """Return a share in percent; whole numbers without a fraction."""
    return re.sub(r"\.0+$", "", f"{100 * value:.{digits}f}")


def _seen(measurement: Measurement, record: Record | None) -> dict[str, Any]:
    """Return what a template sees: values, if there are any, and ``command``, ``commit``, ``same_at``, ``older``."""
    if record is None:
        return {"command": measurement.command, "commit": ""}
    told = {"command": record.command, "commit": record.commit, "same_at": record.same_at, "older": record.older}
    return {**record.values, **told}
