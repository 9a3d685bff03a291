"""``trocar report``, ``view``, ``export``: look at the saved trials of a run."""

from __future__ import annotations

import webbrowser
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from trocar.cli.group import Result
from trocar.cli.options import JsonFlag, OpenBrowser, Port, need
from trocar.cli.progress import progress
from trocar.cli.terminal import beside, details, results
from trocar.counting import counted
from trocar.errors import BadFile, InvalidInput
from trocar.files.output import make_folder
from trocar.files.video import require_encoder

if TYPE_CHECKING:
    from trocar.eval.trial import Trial

MCAP, LEROBOT = "mcap", "lerobot"
"""Formats of recordings and of data sets, besides those of tables."""


def report(
    folder: Annotated[Path, Argument(metavar="DIR", help="Folder of a run.")],
    *,
    session: Annotated[int, Option(metavar="S", help="Session of --trial, as in the name of its folder.")] = 0,
    trial: Annotated[
        int | None,
        Option(
            metavar="K",
            help="Report only on this trial, as in the name of its file; writes into a folder beside it.",
            show_default="all trials; pictures of the first",
        ),
    ] = None,
    video: Annotated[bool, Option("--video", help="Also make a short animation of the trial, video.webp.")] = False,
    mp4: Annotated[
        bool, Option("--mp4", help="Also make video.mp4, the whole trial at its own speed; needs trocar[lerobot].")
    ] = False,
    camera: Annotated[
        str | None,
        Option(
            metavar="NAME",
            help="Film what this camera saw instead of the scene: its images, each until the next one; with --mp4.",
            show_default="the scene",
        ),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Write summary, pictures, replay and an HTML page from saved trials; nothing is recomputed."""
    if trial is None and session:
        raise InvalidInput(f"--session {session}", "is given without --trial", "add --trial K")
    if camera is not None and not mp4:
        raise InvalidInput(f"--camera {camera}", "is given without --mp4", "add --mp4")
    if mp4:
        require_encoder()
    place = None if trial is None else (session, trial)
    if camera is not None:
        from trocar.report.video import images_of  # SciPy only when needed

        images_of(_filmed(folder, place), camera)  # a wrong name is told before anything is drawn
    finish(folder, as_json, interrupted=False, place=place)
    if video:
        _draw_video(folder, place, "video.webp")
    if mp4:
        _draw_video(folder, place, f"video_{camera}.mp4" if camera else "video.mp4", camera)


def _filmed(folder: Path, place: tuple[int, int] | None) -> Trial:
    """Return the trial at a place of a run, or the first one."""
    from trocar.eval.folder import load_trials
    from trocar.eval.trial import Trial

    return Trial.load(trial_in(folder, *place)) if place else load_trials(folder)[0][0]


def _draw_video(folder: Path, place: tuple[int, int] | None, name: str, camera: str | None = None) -> None:
    """Write a video of the scene, or of what a camera saw."""
    from trocar.report.files import report_of
    from trocar.report.video import draw_video, film_camera, images_of

    trial = _filmed(folder, place)
    path = (trial_in(folder, *place).with_suffix("") if place else folder) / name
    with progress() as show:

        def tick(done: int, total: int) -> None:
            show(f"frames of {name}", done, total)

        if camera:
            film_camera(images_of(trial, camera), trial.duration_s, path, tick)
        else:
            draw_video(trial, path, report_of(trial), tick)
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
    from trocar.report.files import kept_pictures, write_report  # SciPy only when needed

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
    strange += kept_pictures(into)
    with progress() as tick:
        summary, files = write_report(folder, trials, strange, into, tick)
    if as_json:
        Result(summary).show(as_json)
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
    from trocar.eval.staged import AGENT_ERROR
    from trocar.report.files import report_of
    from trocar.report.summary import MISSED_WARNING
    from trocar.report.tables import brief_flaws, figure, headline, parts_table, run_table

    report = report_of(trials[0])
    console = details()
    console.print(run_table(summary, report.paper_rows(summary), report.paper_count(summary)))
    for table in [*report.tables(summary), parts_table(summary)]:
        console.print(table)
    stopped = [trial for trial in trials if not trial.finished]
    errors = [trial for trial in stopped if trial.on_robot or trial.ended == AGENT_ERROR]  # even with --quiet
    for trial in (trial for trial in stopped if trial not in errors):
        console.print(_stop_of(trial))
    if summary["failures"]:
        console.print("failures: " + ", ".join(f"{name} {count}" for name, count in summary["failures"].items()))
    compute = ", ".join(f"{name} {ms['p50']:.0f} / {ms['p95']:.0f} ms" for name, ms in summary["compute_ms"].items())
    if compute and summary["realtime_factor"]:
        console.print(f"compute p50 / p95: {compute}; {summary['realtime_factor']:.1f} x real time")
    use = summary["command_limit_use"]
    console.print(
        f"collisions per trial: {figure(summary['collisions_per_trial'])}; "
        f"largest share of the limits in the commands sent: "
        f"velocity {use['velocity']:.2f}, acceleration {use['acceleration']:.2f}"
    )
    if summary["missed_budgets"] > MISSED_WARNING:
        console.print(
            f"warning: {100 * summary['missed_budgets']:.1f} % of computations take longer than the trial's clock "
            f"counted for them, scaled to the machine for which that was declared (this one is "
            f"{summary['machine_speed']:.2f} times as fast): a real arm would have waited"
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
    for replay in [file for file in files if file.name == "replay.html"][:1]:
        console.print(f"watch it: open {replay} in any browser", soft_wrap=True)
    for trial in errors:
        console.print(_stop_of(trial), soft_wrap=True)


def _stop_of(trial: Trial) -> str:
    which = f"session {trial.about['session']}, trial {trial.about['index']}"
    return f"{which} was stopped ({trial.ended}): {trial.reason}"


def view(
    folder: Annotated[Path, Argument(metavar="DIR", help="Folder of a run.")],
    *,
    session: Annotated[int, Option(metavar="S", help="Session, as in the name of its folder.")] = 0,
    trial: Annotated[int, Option(metavar="K", help="Trial, as in the name of its file.")] = 0,
    port: Port = 8080,
    open_browser: OpenBrowser = True,
) -> None:
    """Show a saved trial in 3D in the browser: where arms and objects were, what the scripts did, what cameras saw.

    The page shows planned and driven paths of the tips and the contacts, and beside them how far the tips were off, the
    scripts' time line, the last camera image, and asked, commanded, measured and true joints. Only this machine can
    open it; Ctrl-C ends.
    """
    need("view")
    from trocar.eval.trial import Trial  # SciPy only when needed

    saved = Trial.load(trial_in(folder, session, trial))
    from trocar.report.files import report_of, shown_replay
    from trocar.view.trial_view import TrialView  # viser is heavy

    replay = shown_replay(saved, report_of(saved))
    shown = TrialView(replay, port)
    address = f"http://127.0.0.1:{shown.port}"
    typer.echo(f"{replay.title}: {address} in a browser; Ctrl-C ends", err=True)
    if open_browser:
        webbrowser.open(address)
    with suppress(KeyboardInterrupt):
        shown.play()
    shown.close()


def trial_in(folder: Path, session: int, number: int) -> Path:
    """Return the file of a trial.

    Raises:
        BadFile: the folder holds no trials, or not this one.
    """
    from trocar.eval.folder import where_runs_are
    from trocar.eval.trial import trial_file, trial_files, trial_place

    wanted = trial_file(folder, session, number)
    if wanted.is_file():
        return wanted
    found = [f"--session {place[0]} --trial {place[1]}" for place in map(trial_place, trial_files(folder))]
    if not found:
        if folder.is_file():
            raise BadFile(folder, "is a file", "give the folder of a run")
        raise BadFile(folder, "holds no trial", where_runs_are(folder), kind="folder")
    shown = ", ".join(found[:8]) + (" ..." if len(found) > 8 else "")
    raise BadFile(folder, f"has no trial {number} of session {session}", f"choose one of {shown}")


def export(
    run: Annotated[Path, Argument(metavar="DIR", help="Folder of a run, or the file of one trial.")],
    *,
    out: Annotated[Path, Option(metavar="FOLDER", help="Folder for what is written.")],
    format: Annotated[
        str,
        Option(
            metavar="csv|parquet|mcap|lerobot",
            help="Tables as CSV or Parquet, a recording of ROS 2 messages for each trial, or a data set for learning.",
        ),
    ] = "csv",
    layout: Annotated[
        str | None,
        Option(metavar="lerobot|open-h", help="LeRobot: v3.0, or v2.1 as Open-H has it.", show_default="lerobot"),
    ] = None,
    commanded: Annotated[
        bool,
        Option(
            "--commanded",
            help="LeRobot: actions are what was sent to the controller, corrected for the cables; else what the script "
            "asked for.",
        ),
    ] = False,
    successes: Annotated[bool, Option("--successes", help="LeRobot: leave out trials that missed a goal.")] = False,
    truth: Annotated[
        bool, Option("--truth", help="LeRobot: add columns that only the referee knows; no policy may see them.")
    ] = False,
) -> Result:
    """Write saved trials as flat tables (goals, spans, events, ...), as MCAP for Foxglove, or for LeRobot.

    Tables have a row for each goal, span and so on of all trials, and in the folder 'samples' a table for each trial:
    joints as asked, commanded, measured and true, jaws, tips, bodies. 'columns' says what each column means.

    MCAP has a file for each trial: joints, jaws, tips, bodies and their solids, images, spans, events.

    LeRobot has an episode for each trial: what arms measured and were asked for at 30 Hz, steps, images as videos.
    Interrupted, it keeps what it wrote; the same command continues.
    """
    from trocar.report.export import FORMATS, export_trials  # SciPy only when needed

    if format not in (*FORMATS, MCAP, LEROBOT):
        raise InvalidInput(f"format {format!r}", "is unknown", f"choose one of {', '.join(FORMATS)}, {MCAP}, {LEROBOT}")
    chosen = {"commanded": commanded, "successes": successes, "truth": truth}
    own = {"--layout": layout is not None, **{f"--{name}": given for name, given in chosen.items()}}
    for flag in (flag for flag, given in own.items() if given and format != LEROBOT):
        raise InvalidInput(flag, f"is not for --format {format}", f"drop it, or give --format {LEROBOT}")
    if format in (MCAP, LEROBOT):
        need({MCAP: "bags", LEROBOT: "lerobot"}[format])
    trials, strange = _chosen(run)
    for sentence in strange:
        beside().print(sentence, soft_wrap=True)
    if format == MCAP:
        return _export_mcap(trials, strange, out)
    if format == LEROBOT:
        return export_episodes(trials, strange, out, layout or LEROBOT, **chosen)
    with progress() as tick:
        written = export_trials(trials, out, format, lambda done, total: tick("writing tables", done=done, total=total))
    tables, samples, lines = {}, [], []
    for table in written:
        tables[str(table.path.relative_to(out))] = {"rows": table.rows, "columns": list(table.columns)}
        if table.path.parent != out:
            samples.append(table)
        else:
            lines.append(f"{table.path}: {table.rows} rows of {len(table.columns)} columns")
    rows, count = sum(table.rows for table in samples), len(samples[0].columns)
    lines.append(f"{samples[0].path.parent}: {len(samples)} tables, {rows} rows of {count} columns in all")
    return Result({"out": str(out), "trials": len(trials), "left_aside": strange, "tables": tables}, lines)


def _export_mcap(trials: Sequence[Trial], strange: Sequence[str], out: Path) -> Result:
    """Write an MCAP file for each trial."""
    from trocar.bags.trial import write_mcap

    files: dict[str, dict[str, int]] = {}
    with progress() as tick:
        for number, trial in enumerate(trials):
            tick("writing recordings", done=number, total=len(trials))
            name = f"session_{trial.about['session']:02d}_trial_{trial.about['index']:03d}.mcap"
            files[name] = write_mcap(trial, make_folder(out) / name)
    lines = [
        f"{out / name}: {counted(sum(counts.values()), 'message')} of {counted(len(counts), 'topic')}"
        for name, counts in files.items()
    ]
    return Result({"out": str(out), "trials": len(trials), "left_aside": list(strange), "files": files}, lines)


def export_episodes(trials: Sequence[Trial], strange: Sequence[str], out: Path, layout: str, **chosen: bool) -> Result:
    """Write a LeRobot data set of trials, with a progress bar; ``chosen`` as ``export_lerobot`` has them."""
    from trocar.learn.dataset import export_lerobot

    with progress() as tick:
        done = export_lerobot(trials, out, layout=layout, tick=tick, **chosen)
    left = f"; {counted(done.left_out, 'trial')} left out that missed a goal" if done.left_out else ""
    left += f"; {counted(done.short, 'trial')} left out that stopped at once" if done.short else ""
    line = f"{out}: {counted(done.episodes, 'episode')}, {counted(done.frames, 'frame')}, layout {layout}{left}"
    summary = {"out": str(out), "layout": layout, "episodes": done.episodes, "frames": done.frames}
    summary |= {"features": done.features, "left_out": done.left_out, "short": done.short, "left_aside": list(strange)}
    return Result(summary, [line])


def _chosen(run: Path) -> tuple[Sequence[Trial], list[str]]:
    """Return the trials of a run's folder, or the one in a file, and a sentence for each that was left aside."""
    from trocar.eval.folder import load_trial, load_trials, still_to_do

    if run.suffix == ".npz" and not run.is_dir():
        return [load_trial(run)], []
    if run.is_file():
        raise BadFile(run, "is not a trial", "give the folder of a run, or a file such as trial_000.npz")
    trials, strange = load_trials(run)
    return trials, [*strange, *still_to_do(run, len(trials))]
