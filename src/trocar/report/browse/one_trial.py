"""The page of one trial: its replay, which starts at its first failure, and moments to jump to."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from html import escape
from importlib.util import find_spec

from trocar.eval import TaskReport, in_words
from trocar.eval.scenery import contact_of
from trocar.eval.trial import Trial
from trocar.extras import how_to_install
from trocar.report.browse import addresses
from trocar.report.browse.shelf import Run
from trocar.report.failures import flagged, of_moment, place_of
from trocar.report.files import report_of
from trocar.report.page import Column, document, link, listing, paragraph, section
from trocar.report.tables import came_of, goal_name, reached, reason_of

MOST = 200
"""Maximum number of collisions in the list."""


def one_trial_page(run: Run, trial: Trial, asked: Mapping[str, str]) -> str:
    """Return the page of a trial.

    Args:
        run: of the trial.
        trial: with its arrays.
        asked: where the replay starts: ``goal`` (its number) or ``end``; neither: the first failure.
    """
    session, index = trial.about["session"], trial.about["index"]
    report = report_of(trial)
    moments_s = [
        float(score["start_s"]) if score["succeeded"] else report.failed_s(trial, score) for score in trial.scores
    ]
    view = f"trocar view {shlex.quote(str(run.folder))} --session {session} --trial {index}"
    parts = [
        f"<nav>{_links(run, session, index)}</nav>",
        *([paragraph(f"Stopped: {trial.reason or in_words(trial.ended)}", "warning")] if not trial.finished else []),
        f"<div class=beside>{_player(_begin_s(trial, moments_s, asked))}<div>",
        section("goals", f"{trial.goal_noun.capitalize()}s", _goals(trial, report, moments_s)),
        section("collisions", "Collisions", *_collisions(trial)),
        "</div></div>",
        f"<p class=quiet>Joints, camera images and time line beside the scene: <code>{escape(view)}</code></p>",
    ]
    said = f"{reached(trial.scores)} {trial.goal_noun}s in {trial.duration_s:.1f} s"
    failed = came_of(trial)
    sub = [f"{said}; {failed}." if failed else f"{said}."]
    return document(f"{run.name}: {place_of(trial)}", sub, parts, broad=True)


def _links(run: Run, session: int, index: int) -> str:
    """Return links to all runs, the run, and the trials before and after this one."""
    places = [(trial.about["session"], trial.about["index"]) for trial in run.trials]
    at = places.index((session, index))
    links = [link(addresses.ALL, "All runs"), link(addresses.of_run(run), run.name)]
    if at > 0:
        links.append(link(addresses.of_trial(run, *places[at - 1]), "Trial before"))
    if at + 1 < len(places):
        links.append(link(addresses.of_trial(run, *places[at + 1]), "Next trial"))
    return "".join(links)


def _begin_s(trial: Trial, moments_s: Sequence[float], asked: Mapping[str, str]) -> float:
    """Return the time at which the replay starts; 0 s if there is no such goal, or no failure."""
    if "end" in asked:
        return trial.duration_s
    goal = asked.get("goal", "")
    if goal:
        return moments_s[int(goal)] if goal.isdecimal() and int(goal) < len(moments_s) else 0.0
    failed = [
        at_s
        for at_s, score in zip(moments_s, trial.scores, strict=True)
        if score["attempted"] and not score["succeeded"]
    ]
    return failed[0] if failed else 0.0


def _player(begin_s: float) -> str:
    if find_spec("viser") is None:
        return paragraph(f"The replay needs viser; {how_to_install('view')}", "warning")
    return (
        "<div class=player><p>The replay is being made: some seconds</p>"
        f"<iframe name=replay src='{of_moment(begin_s)}' title='3D replay of the trial'></iframe></div>"
    )


def _goals(trial: Trial, report: TaskReport, moments_s: Sequence[float]) -> str:
    """Return a row for each goal, failures first; a click makes the replay jump there."""
    order = sorted(range(len(trial.scores)), key=lambda k: bool(trial.scores[k]["succeeded"]))
    rows, notes = [], []
    for k in order:
        score = trial.scores[k]
        missed = in_words(str(score["failure"])) or "not attempted"
        result = "done" if score["succeeded"] else flagged(missed)
        goal = link(of_moment(moments_s[k]), goal_name(trial, k, report), target="replay")
        rows.append([goal, result, f"{moments_s[k]:.1f}"])
        notes.append(escape(reason_of(score, report)))
    return listing((Column(trial.goal_noun), Column("result"), Column("at s", number=True)), rows, notes)


def _collisions(trial: Trial) -> list[str]:
    if not trial.collisions:
        return []
    rows = []
    for touch in map(contact_of, trial.collisions[:MOST]):
        what = link(of_moment(touch.time_s), " - ".join(touch.between), target="replay")
        rows.append([what, f"{touch.force_n:.1f}", f"{touch.time_s:.1f}"])
    columns = (Column("between"), Column("up to N", number=True), Column("at s", number=True))
    left = len(trial.collisions) - MOST
    return [listing(columns, rows), *([paragraph(f"{left} more are not listed.", "quiet")] if left > 0 else [])]
