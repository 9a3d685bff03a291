"""The page of one run: its failures first, then its trials, and what it can be compared with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

from trocar.counting import counted
from trocar.eval import in_words
from trocar.report.browse import addresses
from trocar.report.browse.cells import flagged, missed, remarks, success
from trocar.report.browse.shelf import Run
from trocar.report.files import report_of
from trocar.report.page import Column, document, link, listing, paragraph, section, table
from trocar.report.run_page import headline_cards, names_of, place_of
from trocar.report.stills import failed_goals, picked
from trocar.report.tables import came_of, failure_counts, failures_table, reached

MOST = 100
"""Maximum number of failures in the list; of more, some of each kind are shown."""


def one_run_page(run: Run, others: Sequence[Run]) -> str:
    """Return the page of a run; ``others``: runs in the same sessions."""
    about = run.about
    told = {"station": about.get("station"), "difficulty": run.difficulty, "seed": about.get("seed")}
    told["Trocar"] = run.version
    where = ", ".join(f"{what} {value}" for what, value in told.items() if value not in (None, ""))
    links = [link(addresses.ALL, "All runs")]
    if (run.folder / addresses.REPORT).is_file():
        links.append(link(addresses.REPORT, "Its report"))
    if others:
        links.append(link("#compare", "Compare"))
    parts = [
        f"<nav>{''.join(links)}</nav>",
        *([headline_cards(run.figures)] if run.figures else []),
        *(paragraph(said, "warning") for said in remarks(run)),
        *([_failures(run), section("trials", "Trials", _trials(run))] if run.trials else []),
        section("compare", "Compare", *_compared(run, others)),
    ]
    return document(run.name, filter(None, (names_of(about), where, str(run.folder))), parts)


def _failures(run: Run) -> str:
    noun = run.trials[0].goal_noun
    rows = [*_stopped(run), *_missed(run)]
    if not rows:
        return section("failures", "Failures", paragraph(f"None: every {noun} that was attempted succeeded."))
    columns = (Column("what"), Column("failure"), Column("why"), Column("where"), Column("at s", number=True))
    failed = sum(score["attempted"] and not score["succeeded"] for trial in run.trials for score in trial.scores)
    more = f"{counted(failed - MOST, 'more failure')}: in the trials below." if failed > MOST else ""
    hint = paragraph("A click plays the trial from shortly before the moment of the failure.", "quiet")
    title = f"Failures: {failed} of {counted(run.figures['attempted'], noun)}"
    counts = failure_counts(score for trial in run.trials for score in trial.scores)
    kinds = failures_table(counts, run.figures["attempted"], noun, report_of(run.trials[0]))
    by_kind = table(kinds, compact=True) if len(counts) > 1 else ""
    return section("failures", title, by_kind, hint, listing(columns, rows), paragraph(more, "quiet") if more else "")


def _stopped(run: Run) -> Iterator[list[str]]:
    """Yield a row for each trial whose script did not finish."""
    for trial in run.trials:
        if not trial.finished:
            address = addresses.of_trial(run, trial.about["session"], trial.about["index"])
            yield [
                link(f"{address}?end=1", "the whole trial"),
                flagged(in_words(trial.ended)),
                escape(trial.reason),
                place_of(trial),
                f"{trial.duration_s:.1f}",
            ]


def _missed(run: Run) -> Iterator[list[str]]:
    """Yield a row for each goal that was attempted and not reached."""
    report = report_of(run.trials[0])
    for one in picked(failed_goals(run.trials, report), MOST):
        trial = run.trials[one.place]
        yield [
            link(addresses.of_trial(run, one.session, one.trial, one.number), one.what),
            flagged(in_words(one.failure) or "not done"),
            escape(one.reason),
            place_of(trial),
            f"{report.failed_s(trial, trial.scores[one.number]):.1f}",
        ]


def _trials(run: Run) -> str:
    noun = run.trials[0].goal_noun
    columns = (Column("trial"), Column(f"{noun}s done"), Column("time s", number=True))
    columns += (Column("collisions", number=True), Column("failures"))
    rows = []
    for trial in sorted(run.trials, key=lambda trial: not missed(trial)):
        hits = "" if trial.on_robot else str(len(trial.collisions))
        address = addresses.of_trial(run, trial.about["session"], trial.about["index"])
        cells = reached(trial.scores), f"{trial.duration_s:.1f}", hits, flagged(came_of(trial))
        rows.append([link(address, place_of(trial)), *cells])
    return listing(columns, rows)


def _compared(run: Run, others: Sequence[Run]) -> list[str]:
    if not others:
        return []
    columns = (Column("run that met the same sessions"), Column("method"), Column("success (95 %)"))
    rows = [
        [link(addresses.of_pair(run, other), other.name), escape(str(other.about["method"])), success(other)]
        for other in others
    ]
    return [listing(columns, rows)]
