"""The figures in README.md and docs/*.md: measured, written between their markers, and checked.

    python tools/figures.py measure [NAME ...] [--at-most MINUTES] [--again]
    python tools/figures.py write                 tables anew from what was measured; nothing is run
    python tools/figures.py check                 exit code 1: pages are not what was measured, or README not up to date

``measure`` without names measures what the code has changed under, the longest first, two at a time, each with half of
the cores; what was interrupted goes on where it stopped. Figures of trials are carried over if the first two sessions
come out the same to the last bit. How a figure is declared: docs/figures.md, "Adding a figure".
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path

from declared_figures import Measurement, Record, read_measurements, read_record, write_record
from figure_tables import Tables
from measure_figures import FIRST, measure
from source_age import why_older
from trocar.errors import TrocarError

ROOT = Path(__file__).resolve().parents[1]

AT_ONCE = 2
"""Number of measurements that are made at a time."""


class Figures:
    """All that is declared and recorded below a repository's root."""

    def __init__(self, root: Path):
        self.root = root
        self.measurements = read_measurements(root)
        found = {name: read_record(root, name) for name in self.measurements}
        self.records: dict[str, Record] = {name: record for name, record in found.items() if record is not None}

    @property
    def tables(self) -> Tables:
        """Return the tables that the present records give."""
        return Tables(self.root, self.measurements, self.records)

    def older(self) -> dict[str, str]:
        """Return, by name, why measurements are older than the code; those never made are among them."""
        said = {
            name: why_older(self.root, each, self.records[name]) if name in self.records else "never measured"
            for name, each in self.measurements.items()
        }
        return {name: why for name, why in said.items() if why}

    def write(self) -> tuple[list[Path], list[str]]:
        """Note which records are of older code, and write the tables; return what ``Tables.write`` returns."""
        older = self.older()
        for name, record in self.records.items():
            if record.older != (name in older):
                self.keep(name, replace(record, older=name in older))
        return self.tables.write()

    def keep(self, name: str, record: Record) -> None:
        """Keep a record, here and in its file; files are written by one thread alone, or an old one may win."""
        self.records[name] = record
        write_record(self.root, name, record)

    def headlines(self) -> set[str]:
        """Return the measurements that stand in README."""
        tables = self.tables
        return {each for name in tables.names(self.root / "README.md") for each in _used(tables, name)}

    def wrong(self) -> list[str]:
        """Return a sentence for each page unlike its records, record of another command, and unused measurement."""
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
        raise TrocarError(f"measurement {unknown[0]!r} is unknown; choose one of {', '.join(figures.measurements)}")
    older = figures.older()
    asked = given.names or [name for name in figures.measurements if given.again or name in older]
    todo = [figures.measurements[name] for name in asked if figures.measurements[name].minutes <= given.at_most]
    for name in figures.measurements:
        print(f"{name}: {older.get(name) or f'of this code, measured on {figures.records[name].date}'}")
    print(f"{len(todo)} to measure, about {sum(each.minutes for each in todo) / AT_ONCE:.0f} minutes of two idle cores")
    together = sorted((each for each in todo if not each.alone), key=lambda each: -each.minutes)
    alone = [each for each in todo if each.alone]
    failed = _measured(figures, together, AT_ONCE, given.again) + _measured(figures, alone, 1, given.again)
    return int(failed > 0)


def _measured(figures: Figures, todo: Sequence[Measurement], at_once: int, again: bool) -> int:
    """Measure in this order, ``at_once`` at a time, writing the pages after each; return how many failed.

    Unless ``again``, figures of trials are carried over if the first sessions are the same.
    """
    failed, jobs = 0, max(1, (os.cpu_count() or 1) // AT_ONCE)

    def begin(each: Measurement) -> Record:
        print(f"{each.name}: {each.command}", flush=True)
        return measure(figures.root, each, jobs, None if again else figures.records.get(each.name))

    with ThreadPoolExecutor(at_once) as pool:
        running: dict[Future[Record], Measurement] = {pool.submit(begin, each): each for each in todo}
        try:
            for number, done in enumerate(as_completed(running), start=1):
                name = running[done].name
                try:
                    figures.keep(name, done.result())
                    figures.write()
                    same, then = figures.records[name].same_at, figures.records[name].commit
                    told = f"the first {FIRST} sessions are the same as at {then}, carried over" if same else "measured"
                    print(f"[{number}/{len(todo)}] {name}: {told}", flush=True)
                except TrocarError as error:
                    print(f"[{number}/{len(todo)}] {name}: {error}", flush=True)
                    failed += 1
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return failed


def check(figures: Figures) -> int:
    """Say what is wrong and what is older than the code; return 1 if something is wrong, or README not up to date."""
    wrong, older, headlines = figures.wrong(), figures.older(), figures.headlines()
    for sentence in wrong:
        print(f"wrong: {sentence}")
    for name, why in older.items():
        print(f"{'README is out of date' if name in headlines else 'older than the code'}: {name}, {why}")
    current = len(figures.measurements) - len(older)
    print(f"{current} of {len(figures.measurements)} measurements are of today's code; {len(wrong)} mistakes")
    return int(bool(wrong) or bool(headlines & set(older)))


def _used(tables: Tables, table: str) -> Sequence[str]:
    try:
        return tables.measurements_in(table)
    except TrocarError:  # `Figures.wrong` reports it
        return []


def main(words: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """Do what the command line says and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="measure|write|check")
    measuring = verbs.add_parser("measure", help="run commands and write their figures into the pages")
    measuring.add_argument("names", nargs="*", metavar="NAME", help="none: all that are older than the code")
    measuring.add_argument("--at-most", type=float, default=float("inf"), metavar="MINUTES", help="no longer ones")
    measuring.add_argument("--again", action="store_true", help="also what is of today's code, and all sessions")
    verbs.add_parser("write", help="write the tables anew from what was measured")
    verbs.add_parser("check", help="pages against records, and records against the code")
    given = parser.parse_args(words)
    try:
        figures = Figures(root)
        if given.verb == "measure":
            return measure_all(figures, given)
        if given.verb == "check":
            return check(figures)
        changed, wrong = figures.write()
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


if __name__ == "__main__":
    sys.exit(main())
