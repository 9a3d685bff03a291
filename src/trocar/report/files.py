"""Everything that a run's folder shows beside its trials: summary, pictures, replay, page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from trocar.errors import TrocarError
from trocar.extras import how_to_install
from trocar.output import write_json
from trocar.registry import Lazy
from trocar.replay import Replay, Solid
from trocar.report.page import write_page
from trocar.report.storyboard import draw_storyboard
from trocar.report.summary import Summary, summarise
from trocar.report.timechart import draw_timechart
from trocar.tasks import TASKS
from trocar.tasks.kit import TaskReport
from trocar.trials.trial import Trial


def report_of(trial: Trial) -> TaskReport:
    """Return what a trial's task adds to a report; of a task that is not registered here, nothing."""
    name = str(trial.about["task"])
    found = TASKS[name].report if name in TASKS else None
    made = found.load() if isinstance(found, Lazy) else found
    if made is None:
        return TaskReport()
    return made() if isinstance(made, type) else made


def write_report(
    folder: str | Path, trials: Sequence[Trial], strange: Sequence[str] = ()
) -> tuple[Summary, list[Path]]:
    """Write summary, pictures, replay and page; return the summary and the files' paths.

    Args:
        folder: of the run.
        trials: that were finished.
        strange: sentences on what else lies in the folder.
    """
    folder = Path(folder)
    report = report_of(trials[0])
    summary = summarise(trials, report)
    path = write_json(folder / "summary.json", summary, "summary of a run")
    pictures = _pictures(folder, trials, report)
    files = [path, *pictures]
    if find_spec("viser") is not None:
        from trocar.view.replay import write_replay  # noqa: PLC0415 (an extra)

        files.append(write_replay(_for_people(trials[0].replay(), report), folder / "replay.html"))
    notes = [*report.notes(trials), *strange]
    return summary, [*files, write_page(folder / "report.html", summary, pictures, notes)]


def _for_people(replay: Replay, report: TaskReport) -> Replay:
    """Return a replay whose bodies have the colours that they have in pictures for people."""

    def painted(solid: Solid) -> Solid:
        rgb = next((rgb for prefix, rgb in report.colours.items() if solid.body.startswith(prefix)), None)
        return solid if rgb is None else replace(solid, rgba=(*rgb, solid.rgba[3]))

    return replace(replay, solids=tuple(painted(solid) for solid in replay.solids))


def _pictures(folder: Path, trials: Sequence[Trial], report: TaskReport) -> list[Path]:
    first = trials[0]
    about = first.about
    what = ", ".join(str(about[key]) for key in ("task", "variant", "method") if about[key])
    files = []
    if find_spec("mujoco") is not None:
        title = f"{what}, session {about['session']}, trial {about['index']} of seed {about['seed']} (simulated)"
        files.append(draw_trial(first, folder / "storyboard.png", title, report))
    if first.spans:
        files += report.pictures(folder, trials)
        files.append(draw_timechart(first, folder / "timechart.png", title=f"Time chart, {what}"))
    return files


def draw_trial(trial: Trial, path: str | Path, title: str = "", report: TaskReport | None = None) -> Path:
    """Draw what is worth a picture in a trial as a storyboard, and return its path.

    Raises:
        TrocarError: there is no simulator here, whose rays draw the pictures.
    """
    if find_spec("mujoco") is None:
        raise TrocarError(f"pictures of a trial need mujoco; {how_to_install('sim')}")
    from trocar.sim.photograph import Photographer  # noqa: PLC0415 (an extra)

    report = report or report_of(trial)
    view = report.view
    photographer = Photographer(trial.replay(), view, report.colours)
    frames = [(caption, photographer.picture(time_s)) for caption, time_s in report.moments(trial)]
    return draw_storyboard(frames, path, title or "Storyboard", columns=3 if len(frames) <= 9 else 4)
