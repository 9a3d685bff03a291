"""Everything in a run's folder besides its trials: summary, pictures, replay, page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from trocar.counting import Tick, untold
from trocar.eval import TASKS, Task, TaskReport
from trocar.eval.folder import requested
from trocar.eval.trial import Trial, trial_file
from trocar.eval.trials import noted
from trocar.extras import how_to_install
from trocar.files.output import make_folder, write_json
from trocar.registry import loaded
from trocar.replay import Replay, painted
from trocar.report.failures import (
    REPLAY,
    Failed,
    Moments,
    failed_goals,
    moments_of,
    of_moment,
    picked,
    place_of,
    stopped,
)
from trocar.report.page import Captioned
from trocar.report.run_page import command_of, names_of, write_page
from trocar.report.stills import (
    MOST_FAILED,
    can_photograph,
    draw_failed,
    draw_storyboard,
    photographer_of,
)
from trocar.report.summary import Summary, summarise
from trocar.report.timechart import draw_timechart


def report_of(trial: Trial) -> TaskReport:
    """Return what a trial's task adds to a report; an empty report if the task is not registered here."""
    name = str(trial.about["task"])
    return task_report(TASKS[name]) if name in TASKS else TaskReport()


def task_report(task: Task | type[Task]) -> TaskReport:
    """Return what a task adds to a report."""
    made = loaded(task.report)
    if made is None:
        return TaskReport()
    return made() if isinstance(made, type) else made


def write_report(
    folder: str | Path,
    trials: Sequence[Trial],
    strange: Sequence[str] = (),
    into: str | Path | None = None,
    tick: Tick = untold,
) -> tuple[Summary, list[Path]]:
    """Write summary, pictures, replays and page of a run's trials; return the summary and the files' paths.

    The first trial's replay lies beside the page. Those of at most ``MOST_REPLAYS`` other trials, in which something
    failed, lie in the folders that ``trocar report --session --trial`` makes.

    Args:
        folder: of the run.
        trials: the finished ones, or those to report on.
        strange: sentences on unexpected files in the folder.
        into: folder for the files; None: the run's.
        tick: is told which replay is being made.
    """
    run, folder = Path(folder), Path(folder if into is None else into)
    report, first = report_of(trials[0]), trials[0]
    summary = summarise(trials, report)
    make_folder(folder)
    files = [write_json(folder / "summary.json", summary, "summary of a run")]
    blind = first.on_robot  # nobody knows where bodies were, so there is nothing to photograph
    storyboard = [] if blind else _pictures(folder, trials, report)
    timechart = _chart(folder, first)
    notes = noted(trials)
    failed = failed_goals(notes, report)
    shown = [] if blind else picked(failed, MOST_FAILED)
    failed_pictures = draw_failed(folder / "failed", trials, shown, report, can_photograph())
    replays, moments = _played(folder, trials, notes, failed, report, tick)
    page = write_page(
        folder / "report.html",
        summary,
        notes,
        report,
        failed=failed,
        failed_pictures=failed_pictures,
        moments=moments,
        storyboard=storyboard,
        timechart=timechart,
        notes=report.notes(trials),
        strange=strange,
        command=command_of(first.about, *(requested(run) or _there(notes))),
    )
    drawn = [shown.path for shown in (*storyboard, *([timechart] if timechart else []), *failed_pictures)]
    return summary, [*files, *replays, *drawn, page]


MOST_REPLAYS = 10
"""Maximum number of trials with failures, besides the first trial, whose replays a report makes."""


def _played(
    folder: Path,
    trials: Sequence[Trial],
    notes: Sequence[Trial],
    failed: Sequence[Failed],
    report: TaskReport,
    tick: Tick,
) -> tuple[list[Path], Moments]:
    """Write the replays of the first trial and of some with failures; return them, and where each failure is played.

    Failures are also played in replays that were there before.
    """
    places = [(trial.about["session"], trial.about["index"]) for trial in notes]
    folders = [folder, *(trial_file(folder, *place).with_suffix("") for place in places[1:])]
    failing = dict.fromkeys([*stopped(notes), *(one.place for one in picked(failed, MOST_FAILED))])
    chosen = [0, *[number for number in failing if number][:MOST_REPLAYS]] if find_spec("viser") is not None else []
    for done, number in enumerate(chosen):
        from trocar.view.replay import write_replay  # an extra

        tick("replays", done, len(chosen))
        write_replay(shown_replay(trials[number], report), make_folder(folders[number]) / REPLAY)

    def read(number: int) -> Trial:
        return (trials if (folders[number] / REPLAY).is_file() else notes)[number]

    def address(number: int, goal: int | None, at_s: float) -> str:
        del goal
        there = (folders[number] / REPLAY).is_file()
        return (folders[number].relative_to(folder) / of_moment(at_s)).as_posix() if there else ""

    return [folders[number] / REPLAY for number in chosen], moments_of(notes, failed, report, read, address)


def shown_replay(trial: Trial, report: TaskReport) -> Replay:
    """Return a trial's replay, its bodies in the colours that its task defines for people."""
    replay = trial.replay()
    return replace(replay, solids=painted(replay.solids, report.colours))


def kept_pictures(folder: str | Path) -> list[str]:
    """Return a sentence if the folder holds pictures of an earlier report that cannot be drawn again here."""
    folder, kept = Path(folder), []
    if not can_photograph():
        kept += [name for name in ("storyboard.png", "failed") if (folder / name).exists()]
    if find_spec("viser") is None and (folder / "replay.html").is_file():
        kept.append("replay.html")
    if not kept:
        return []
    return [f"kept from an earlier report: {', '.join(kept)}; to draw them again, {how_to_install('sim')}"]


def _pictures(folder: Path, trials: Sequence[Trial], report: TaskReport) -> list[Captioned]:
    """Draw the first trial and the task's pictures of all trials, and return these pictures."""
    first, found = trials[0], []
    place = place_of(first)
    path = folder / "storyboard.png"
    if can_photograph():
        draw_trial(first, path, report)
    if path.is_file():  # drawn now, or kept
        moments = "; ".join(caption for caption, _ in report.moments(first))
        found.append(Captioned(path, f"Pictures of {place}: {moments}", f"{place.capitalize()} step by step"))
    for path in report.pictures(folder, trials) if first.spans else ():
        said = next((text for name, text in report.captions.items() if path.stem.startswith(name)), path.stem)
        found.append(Captioned(path, f"Chart: {said}", said))
    return found


def _chart(folder: Path, trial: Trial) -> Captioned | None:
    """Draw the time chart of a trial; None if its script noted no spans."""
    if not trial.spans:
        return None
    chart = draw_timechart(trial, folder / "timechart.png", title=f"Time chart, {names_of(trial.about)}")
    said = f"Where the time went in {place_of(trial)}: a row for each {trial.goal_noun} and arm, a bar for each step"
    return Captioned(chart, f"Chart: {said}", said)


def _there(trials: Sequence[Trial]) -> tuple[int, int]:
    """Return the numbers of sessions, and of trials in each, that these trials span."""
    places = [(trial.about["session"], trial.about["index"]) for trial in trials]
    return 1 + max(session for session, _ in places), 1 + max(index for _, index in places)


def draw_trial(trial: Trial, path: str | Path, report: TaskReport) -> Path:
    """Draw the main moments of a trial as a storyboard, and return its path."""
    photographer = photographer_of(trial, report)
    frames = [(caption, photographer.picture(time_s)) for caption, time_s in report.moments(trial)]
    title = f"{names_of(trial.about)}, {place_of(trial)} of seed {trial.about['seed']} (simulated)"
    return draw_storyboard(frames, path, title, columns=3 if len(frames) <= 9 else 4)
