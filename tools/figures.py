"""The figures in README.md and docs/*.md: measured, written between their markers, and checked.

    python tools/figures.py measure [NAME ...] [--at-most MINUTES] [--jobs N] [--again] [--busy]
    python tools/figures.py write                 tables anew from what was measured; nothing is run
    python tools/figures.py check                 pages against records (exit code 1), and what is older than the code

``measure`` without names measures what the code has changed under; what was interrupted goes on where it stopped.
How a figure is declared: docs/figures.md, "Adding a figure".
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from declared_figures import Measurement, Record, read_measurements, read_record
from figure_tables import Tables
from measure_figures import is_busy, measure
from source_age import why_older
from trocar.errors import TrocarError

ROOT = Path(__file__).resolve().parents[1]


class Figures:
    """All that is declared and recorded below a repository's root."""

    def __init__(self, root: Path):
        self.root = root
        self.measurements = read_measurements(root)
        found = {name: read_record(root, name) for name in self.measurements}
        self.records: dict[str, Record] = {name: record for name, record in found.items() if record is not None}

    @property
    def tables(self) -> Tables:
        """Return the tables as they are by what was measured up to now."""
        return Tables(self.root, self.measurements, self.records)

    def older(self) -> dict[str, str]:
        """Return why measurements are older than the code, by name; those never made are among them."""
        said = {
            name: why_older(self.root, each, self.records[name]) if name in self.records else "never measured"
            for name, each in self.measurements.items()
        }
        return {name: why for name, why in said.items() if why}

    def wrong(self) -> list[str]:
        """Return a sentence for each page that is not what was measured, and each record of another command."""
        found = [
            f"{name} was measured by {record.command!r}, but is declared as {self.measurements[name].command!r}; "
            "measure it again"
            for name, record in self.records.items()
            if record.command != self.measurements[name].command
        ]
        tables, used = self.tables, set()
        for page in tables.pages:
            used |= {each for name in tables.names(page) for each in _used(tables, name)}
            text, problems = tables.rendered(page)
            found += [f"{page.name}: {problem}" for problem in problems]
            if text != page.read_text(encoding="utf-8"):
                found.append(f"{page.name}: tables are not what was measured; python tools/figures.py write")
        return found + [f"{name} stands in no table; take it out" for name in sorted(set(self.measurements) - used)]


def measure_all(figures: Figures, given: argparse.Namespace) -> int:
    """Measure what was asked for, writing pages after each, and return the exit code."""
    unknown = [name for name in given.names if name not in figures.measurements]
    if unknown:
        raise TrocarError(f"measurement {unknown[0]!r} is unknown; choose of {', '.join(figures.measurements)}")
    older = figures.older()
    asked = given.names or list(figures.measurements)
    todo = [figures.measurements[name] for name in asked if given.again or given.names or name in older]
    todo = sorted((each for each in todo if each.minutes <= given.at_most), key=lambda each: each.minutes)
    print(f"{len(todo)} to measure, about {sum(each.minutes for each in todo):.0f} minutes of an idle machine")
    failed = 0
    for number, each in enumerate(todo, start=1):
        print(f"[{number}/{len(todo)}] {each.name}: {each.command}", flush=True)
        failed += not _measured(figures, each, given)
    return int(failed > 0)


def _measured(figures: Figures, each: Measurement, given: argparse.Namespace) -> bool:
    """Measure one and write the pages; return whether that worked."""
    if each.machine and is_busy() and not given.busy:
        print("  left out: it measures times, and this machine is busy; wait, or say --busy")
        return False
    try:
        figures.records[each.name] = measure(figures.root, each, given.jobs)
        figures.tables.write()
    except TrocarError as error:
        print(f"  {error}")
        return False
    return True


def check(figures: Figures) -> int:
    """Say what is wrong and what is older than the code; return 1 if something is wrong."""
    wrong, older, tables = figures.wrong(), figures.older(), figures.tables
    for sentence in wrong:
        print(f"wrong: {sentence}")
    for name, why in older.items():
        pages = [page.name for page in tables.pages if any(name in _used(tables, t) for t in tables.names(page))]
        print(f"older than the code: {name} ({', '.join(pages)}) {why}")
    current = len(figures.measurements) - len(older)
    print(f"{current} of {len(figures.measurements)} measurements are of today's code; {len(wrong)} mistakes")
    return int(bool(wrong))


def _used(tables: Tables, table: str) -> Sequence[str]:
    try:
        return tables.measurements_in(table)
    except TrocarError:  # is told as a mistake
        return []


def main(words: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """Do what the command line says and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="measure|write|check")
    measuring = verbs.add_parser("measure", help="run commands and write their figures into the pages")
    measuring.add_argument("names", nargs="*", metavar="NAME", help="none: all that are older than the code")
    measuring.add_argument("--at-most", type=float, default=float("inf"), metavar="MINUTES", help="no longer ones")
    measuring.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="how many trials at once")
    measuring.add_argument("--again", action="store_true", help="also what is of today's code")
    measuring.add_argument("--busy", action="store_true", help="measure times though other things run here")
    verbs.add_parser("write", help="write the tables anew from what was measured")
    verbs.add_parser("check", help="pages against records, and records against the code")
    given = parser.parse_args(words)
    try:
        figures = Figures(root)
        if given.verb == "measure":
            return measure_all(figures, given)
        if given.verb == "check":
            return check(figures)
        changed, wrong = figures.tables.write()
        for page in changed:
            print(f"written: {page.relative_to(root)}")
        for sentence in wrong:
            print(f"left as it is: {sentence}")
        return int(bool(wrong))
    except TrocarError as error:
        print(error, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped; what was measured stands in the pages; run the same command to continue", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
