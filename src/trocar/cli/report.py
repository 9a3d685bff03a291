"""``trocar report``: look at the saved trials of a run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from trocar.cli.plugin import Plugins
from trocar.cli.progress import progress
from trocar.cli.terminal import beside, details, results
from trocar.cli.view import trial_in
from trocar.counting import counted
from trocar.errors import TrocarError

if TYPE_CHECKING:
    from trocar.eval.trial import Trial

JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")],
    *,
    session: Annotated[int, typer.Option(metavar="S", help="Session of --trial, as in the name of its folder.")] = 0,
    trial: Annotated[
        int | None,
        typer.Option(
            metavar="K",
            help="Report only on this trial, as in the name of its file; writes into a folder beside it.",
            show_default="all trials; pictures of the first",
        ),
    ] = None,
    video: Annotated[
        bool, typer.Option("--video", help="Also make a short animation of the trial, video.webp.")
    ] = False,
    plugin: Plugins = None,
    as_json: JsonFlag = False,
) -> None:
    """Write summary, pictures, replay and an HTML page from saved trials; nothing is recomputed."""
    del plugin  # loaded when it was parsed
    if trial is None and session:
        raise TrocarError(f"--session {session} is given without --trial; add --trial K")
    place = None if trial is None else (session, trial)
    finish(folder, as_json, interrupted=False, place=place)
    if video:
        _draw_video(folder, place)


def _draw_video(folder: Path, place: tuple[int, int] | None) -> None:
    from trocar.eval.folder import load_trials
    from trocar.eval.trial import Trial, trial_file
    from trocar.report.files import report_of
    from trocar.report.video import draw_video

    trial = Trial.load(trial_file(folder, *place)) if place else load_trials(folder)[0][0]
    with progress() as tick:
        path = draw_video(
            trial,
            (trial_file(folder, *place).with_suffix("") if place else folder) / "video.webp",
            report_of(trial),
            lambda done, total: tick("frames of video.webp", done, total),
        )
    beside().print(f"video: {path}", soft_wrap=True)


def finish(folder: Path, as_json: bool, interrupted: bool, place: tuple[int, int] | None = None) -> bool:
    """Write and print the report of a folder's trials; return whether every goal of every trial was reached.

    Args:
        folder: of the run.
        as_json: print the summary as JSON.
        interrupted: whether the run was interrupted.
        place: session and number of the trial to report on; None: all.
    """
    from trocar.eval import TASKS
    from trocar.eval.folder import load_trials, still_to_do
    from trocar.eval.trial import trial_files
    from trocar.report.files import write_report  # SciPy only when needed

    if interrupted and not trial_files(folder):
        beside().print("stopped before the first trial was finished; the same command starts again")
        return False
    trials, strange = load_trials(folder)
    into = folder
    if place is None:
        strange += still_to_do(folder, len(trials))
    else:
        path = trial_in(folder, *place)
        trials, strange, into = trials.only(path), [], path.with_suffix("")
    task = trials[0].about["task"]
    if task not in TASKS:
        strange.append(
            f"task {task!r} is unknown here, so its own pictures and figures are left out; add --plugin FILE"
        )
    summary, files = write_report(folder, trials, strange, into)
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        _show(summary, trials, strange, files, interrupted)
    return summary["succeeded"] == summary["attempted"]


def _show(
    summary: Mapping[str, Any],
    trials: Sequence[Trial],
    strange: Sequence[str],
    files: Sequence[Path],
    interrupted: bool,
) -> None:
    from trocar.report.files import report_of
    from trocar.report.flaws import brief_flaws
    from trocar.report.summary import MISSED_WARNING
    from trocar.report.tables import headline, parts_table, run_table

    report = report_of(trials[0])
    console = details()
    console.print(run_table(summary, report.paper_rows(summary), report.paper_count(summary)))
    for table in [*report.tables(summary), parts_table(summary)]:
        console.print(table)
    for trial in (trial for trial in trials if not trial.finished):
        where = f"session {trial.about['session']}, trial {trial.about['index']}"
        console.print(f"{where} was stopped ({trial.ended}): {trial.reason}")
    if summary["failures"]:
        console.print("failures: " + ", ".join(f"{name} {count}" for name, count in summary["failures"].items()))
    compute = ", ".join(f"{name} {ms['p50']:.0f} / {ms['p95']:.0f} ms" for name, ms in summary["compute_ms"].items())
    if compute and summary["realtime_factor"]:
        console.print(f"compute p50 / p95: {compute}; {summary['realtime_factor']:.1f} x real time")
    use = summary["command_limit_use"]
    console.print(
        f"collisions per trial: {summary['collisions_per_trial']:.2f}; "
        f"largest share of the limits in the commands sent: "
        f"velocity {use['velocity']:.2f}, acceleration {use['acceleration']:.2f}"
    )
    if summary["missed_budgets"] > MISSED_WARNING:
        console.print(
            f"warning: {100 * summary['missed_budgets']:.1f} % of computations took longer than the trial's clock "
            "counted for them; on this machine a real arm would have waited"
        )
    console.print(brief_flaws(summary["flaws"]))
    for sentence in report.notes(trials):
        console.print(sentence)
    console = results()
    for sentence in strange:
        console.print(sentence)
    console.print(headline(summary))
    if interrupted:
        console.print(f"stopped; {counted(len(trials), 'finished trial')} kept; run the same command to continue")
    console.print("files: " + ", ".join(str(file) for file in files), soft_wrap=True)
    for replay in (file for file in files if file.name == "replay.html"):
        console.print(f"watch it: open {replay} in any browser", soft_wrap=True)
