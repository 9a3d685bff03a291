"""The page of a run, to hand to a colleague."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from rich.table import Table

from trocar.eval import in_words
from trocar.files.output import write_text
from trocar.report.failed import Failed
from trocar.report.page.assumed import assumed, reproduced
from trocar.report.page.elements import document, of_table, paragraph, picture, pictures, section
from trocar.report.page.headline import headline, warnings
from trocar.report.picture import Picture
from trocar.report.tables import parts_table

REPLAY = "replay.html"


@dataclass(frozen=True, eq=False)
class RunReport:
    """Everything that the page of a run shows.

    Attributes:
        summary: keys as in ``summary.json``.
        compared: tables of the run beside the paper.
        goals: tables of the outcomes of goals and trials.
        failures: how often each failure occurred.
        failed: all goals that were not reached.
        failed_pictures: of some of them.
        storyboard: pictures of a trial, and others that a task draws.
        timechart: what took the time; None: nothing was noted.
        shown: which trial the pictures and the replay are of.
        notes: sentences that a reader must know.
        strange: sentences about what is missing or unexpected.
        command: that repeats the run.
    """

    summary: Mapping[str, Any]
    compared: Sequence[Table]
    goals: Sequence[Table]
    failures: Table
    failed: Sequence[Failed]
    failed_pictures: Sequence[Picture]
    storyboard: Sequence[Picture]
    timechart: Picture | None
    shown: str
    notes: Sequence[str]
    strange: Sequence[str]
    command: str


def write_page(path: str | Path, run: RunReport) -> Path:
    """Write the page of a run and return its path; the replay, if there is one, is beside it."""
    summary = run.summary
    names = (str(summary[key]) for key in ("task", "variant", "method") if summary[key])
    title = ", ".join(name.replace("-", " ") for name in names)
    sections = {
        "compared": ("Beside the paper" if len(run.compared[0].rows) > 1 else "In numbers", _compared(run)),
        "goals": (f"{summary['goal_noun'].capitalize()}s", [of_table(table) for table in run.goals]),
        "failures": ("Failures", _failures(run)),
        "replay": ("Replay", _replay(Path(path), run)),
        "pictures": ("Pictures", [picture(shown) for shown in run.storyboard]),
        "time": ("Time", _time(run)),
        "assumed": ("What was assumed", assumed(summary, run.notes)),
        "again": ("How to run it again", reproduced(summary, run.command)),
    }
    links = "".join(f'<a href="#{name}">{escape(head)}</a>' for name, (head, parts) in sections.items() if any(parts))
    parts = [
        f"<nav aria-label=Contents>{links}</nav>",
        headline(summary),
        *(paragraph(sentence, "warning") for sentence in [*run.strange, *warnings(summary)]),
        *(section(name, head, *inside) for name, (head, inside) in sections.items()),
    ]
    sub = [_whereabouts(summary), "Simulated. Research use only, not a medical device."]
    return write_text(path, document(f"{title[:1].upper()}{title[1:]}", sub, parts), "report")


def _whereabouts(summary: Mapping[str, Any]) -> str:
    model = f", cable model {summary['model']}" if summary["model"] else ""
    return (
        f"{_count(summary['trials'], 'trial')} in {_count(summary['sessions'], 'session')} at station "
        f"{summary['station']}, seed {summary['seed']}{model}, planner {summary['planner']}."
    )


def _compared(run: RunReport) -> list[str]:
    return [of_table(table) for table in run.compared]


def _failures(run: RunReport) -> list[str]:
    """Return the failures by name, and a picture of each goal that was not reached."""
    if not run.failed:
        return [paragraph(f"No failure: every {run.summary['goal_noun']} that was attempted succeeded.")]
    more = len(run.failed) - len(run.failed_pictures)
    said = [of_table(run.failures), pictures(run.failed_pictures)]
    if more and run.failed_pictures:
        left = ", ".join(
            f"session {one.session}, trial {one.trial}, {one.what}: {in_words(one.failure)}"
            for one in _without_picture(run)
        )
        said.append(paragraph(f"{_count(more, 'more failure')} without a picture here: {left}.", "quiet"))
    return said


def _without_picture(run: RunReport) -> list[Failed]:
    """Return the failed goals that have no picture."""
    drawn = {shown.path.stem for shown in run.failed_pictures}
    return [one for one in run.failed if one.stem not in drawn]


def _replay(path: Path, run: RunReport) -> list[str]:
    if not path.with_name(REPLAY).is_file():
        return []
    return [
        f"<figure><iframe class=screen src={REPLAY} loading=lazy title='3D replay of {escape(run.shown)}'></iframe>"
        f'<figcaption>{escape(run.shown.capitalize())} in 3D; drag to rotate, scroll to zoom. <a href="{REPLAY}">'
        f"{REPLAY}</a> is next to this page.</figcaption></figure>"
    ]


def _time(run: RunReport) -> list[str]:
    parts = of_table(parts_table(run.summary)) if run.summary["parts_s"] else ""
    return [parts, picture(run.timechart) if run.timechart else ""]


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
