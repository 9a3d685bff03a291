"""The page of one run: its failures first, then its trials, and what it can be compared with."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from trocar.counting import counted
from trocar.report.browse import addresses
from trocar.report.browse.cells import missed, remarks, success
from trocar.report.browse.shelf import Run
from trocar.report.failures import failed_goals, failures_list, flagged, moments_of, place_of
from trocar.report.files import report_of
from trocar.report.page import Column, document, link, listing, paragraph, section, table
from trocar.report.run_page import headline_cards, names_of
from trocar.report.tables import came_of, failure_counts, failures_table, reached


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
    noun, attempted, report = run.trials[0].goal_noun, run.figures["attempted"], report_of(run.trials[0])
    failed = failed_goals(run.trials, report)

    def address(place: int, number: int | None, at_s: float) -> str:
        del at_s  # the trial's own page finds it in the whole trial
        about = run.trials[place].about
        found = addresses.of_trial(run, about["session"], about["index"], number)
        return f"{found}?end=1" if number is None else found

    moments = moments_of(run.trials, failed, report, run.trials.__getitem__, address)
    rows = failures_list(run.trials, failed, moments)
    if not rows:
        return section("failures", "Failures", paragraph(f"None: every {noun} that was attempted succeeded."))
    counts = failure_counts(score for trial in run.trials for score in trial.scores)
    by_kind = table(failures_table(counts, attempted, noun, report), compact=True) if len(counts) > 1 else ""
    return section("failures", f"Failures: {len(failed)} of {counted(attempted, noun)}", by_kind, rows)


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
