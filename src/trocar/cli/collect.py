"""``trocar calibrate collect``: images of spheres on a moving arm, registration, cable model, report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from typer import Argument, Option

from trocar.calibration.excitation import SAMPLES
from trocar.cli.group import Result
from trocar.cli.options import EnableMotion, Seed, Yes, need
from trocar.cli.out_folder import check_out_folder, default_folder, differing
from trocar.cli.progress import progress
from trocar.cli.robot import about_motion, agreed
from trocar.cli.task_group import OF_RUN
from trocar.cli.terminal import beside
from trocar.errors import InvalidInput, TrocarError
from trocar.files.output import make_folder, write_json, write_text

if TYPE_CHECKING:
    from trocar.collect.collection import Collection
    from trocar.collect.on_robot import RobotCollection
    from trocar.collect.plan import CollectionPlan
    from trocar.lab import Station

SESSION, COLLECTION, FIT = range(3)
"""Streams of randomness under the seed."""
FLAWS, ROBOT, DIFFICULTY = (OF_RUN[name].metadata for name in ("flaws", "robot", "difficulty"))
REPORT = "report of a calibration"
ABOUT_OUT = "Folder for the files; default out/calibration-STATION-SEED-OPTIONS."


def collect(
    station: Annotated[
        str,
        Argument(
            metavar="[STATION]",
            help="Of the simulated cell: name of a built-in station, or a TOML file.",
            show_default="that of --robot",
        ),
    ] = "",
    *,
    robot: Annotated[str, Option(metavar=ROBOT["metavar"], help=ROBOT["help"])] = "",
    arm: Annotated[
        list[str] | None, Option(metavar="ARM", help="Which arm; may be given several times.", show_default="all")
    ] = None,
    rows: Annotated[int, Option(help="Samples of each arm; the paper has 1355.")] = SAMPLES,
    wide: Annotated[
        bool, Option("--wide", help="Swing the wrist widely, instead of the paper's smooth motion.")
    ] = False,
    seed: Seed = 0,
    out: Annotated[Path | None, Option(metavar="DIR", help=ABOUT_OUT)] = None,
    fit: Annotated[bool, Option(help="Also fit a cable model, and evaluate it on the rows left out.")] = True,
    model: Annotated[str, Option(help="Cable model: offset, ridge, play, lstm (extra 'learn').")] = "play",
    fraction: Annotated[float, Option(help="First share of the rows that the model is fitted on.")] = 0.8,
    difficulty: Annotated[str, Option(help=DIFFICULTY["help"])] = "recorded",
    flaw: Annotated[list[str] | None, Option(metavar=FLAWS["metavar"], help=FLAWS["help"])] = None,
    enable_motion: EnableMotion = False,
    yes: Yes = False,
) -> Result:
    """Calibrate arms from images of spheres that they wear: joints, bases, cable models.

    The arms are those of a simulated cell, or real ones (--robot). Interrupted, it keeps what it has; run the same
    command to continue.
    """
    need("sim")
    of_cell = differing(collect, {"difficulty": difficulty, "flaw": flaw, "station": station})
    _require_one_kind(robot, of_cell, differing(collect, {"enable_motion": enable_motion, "yes": yes}))
    given = (
        {"arm": arm, "rows": rows, "wide": wide, "fit": fit, "model": model, "fraction": fraction}
        | of_cell
        | {"station": ""}
    )
    from trocar.collect.chain import calibrated, collection_table
    from trocar.collect.collection import Collection  # the simulator is heavy
    from trocar.hardware.kinds import robot_of
    from trocar.lab import load_station, station_text
    from trocar.lab.flaws import Difficulty
    from trocar.lab.station_file import with_registered

    source = robot_of(robot)[1] if robot else station
    folder = out or default_folder(f"calibration-{Path(source).stem}-{seed}", differing(collect, given))
    loaded = replace(load_station(source), difficulty=Difficulty.of(difficulty, flaw or ())).require_relevant()
    collections = _collections(loaded, arm or list(loaded.arms), seed, rows, real=bool(robot), wide=wide)
    if fit:
        _check_fit(model, fraction, rows)
    check_out_folder(folder, {"report.json": REPORT, "station.toml": "station"}, [source])
    make_folder(folder)
    if robot and not _agreed(robot, loaded, collections, folder, enable_motion=enable_motion, yes=yes):
        raise typer.Exit(1)
    figures: dict[str, Any] = {}
    files, bases = [], {}
    try:
        with progress() as tick:
            for name, collection in collections.items():
                tick(f"images of {name}", 0, len(collection.q_cmd))
            for number, (name, collection) in enumerate(collections.items()):

                def listen(done: int, total: int, name: str = name) -> None:
                    tick(f"images of {name}", done, total)

                path = spheres_file(folder, name)
                if isinstance(collection, Collection):
                    centers = collection.run(path, listen)
                else:
                    centers = _on_robot(robot, loaded, collection, path, listen)
                rng, kind = np.random.default_rng([seed, FIT, number]), model if fit else None
                found = calibrated(collection, centers, folder, model=kind, fraction=fraction, rng=rng)
                bases[name] = collection.T_world_camera @ found.measured.T_camera_base
                files.append(folder / f"recording_{name}.npz")
                figures[name], pictures = found.drawn(folder)
                files += pictures
    except KeyboardInterrupt:
        beside().print(f"stopped; what was collected is in {folder}; run the same command to continue")
        raise typer.Exit(130) from None
    summary = {"station": source, "seed": seed, "arms": figures}
    report, text = folder / "report.json", folder / "station.toml"
    write_json(report, summary, REPORT)
    write_text(text, with_registered(station_text(source), bases), "station")
    files += [text, report]
    return Result(summary, ["files: " + ", ".join(map(str, files))], [collection_table(figures)])


def spheres_file(folder: Path, arm: str) -> Path:
    """Return the file of an arm's collected sphere centres."""
    return folder / f"spheres_{arm}.npz"


def _require_one_kind(robot: str, of_cell: Mapping[str, Any], of_robot: Mapping[str, Any]) -> None:
    """Raise InvalidInput unless a station or a robot is named, and every option fits it."""
    if not (robot or "station" in of_cell):
        raise InvalidInput("a collection", "has no arms", "name a STATION to simulate, or a robot (--robot)")
    unfit = [f"--{name.replace('_', '-')}" for name in (of_cell if robot else of_robot)]
    if unfit and robot:
        what = unfit[0].replace("--station", "STATION")
        raise InvalidInput(what, f"is of a simulated cell, and --robot {robot} drives real arms", "drop one of them")
    if unfit:
        raise InvalidInput(unfit[0], "is for real arms, and no --robot is named", "drop it, or name a robot")


def _collections(
    station: Station, arms: Sequence[str], seed: int, rows: int, *, real: bool, wide: bool
) -> Mapping[str, Collection | RobotCollection]:
    """Return the collection of each arm: of real arms, or of a simulated session of this seed."""
    from trocar.collect.collection import Collection
    from trocar.collect.on_robot import RobotCollection
    from trocar.lab import require_reach
    from trocar.lab.session import draw_session

    boxes = {name: station.calibration_box(name) for name in arms}
    seeds = {name: np.random.SeedSequence([seed, COLLECTION, list(station.arms).index(name)]) for name in boxes}
    if real:
        return {name: RobotCollection(station, name, seeds[name], rows, wide=wide) for name in boxes}
    require_reach(station)
    session = draw_session(station, np.random.default_rng([seed, SESSION]))
    return {name: Collection(session, name, box, seeds[name], rows, wide=wide) for name, box in boxes.items()}


def _agreed(
    robot: str,
    station: Station,
    collections: Mapping[str, CollectionPlan],
    folder: Path,
    *,
    enable_motion: bool,
    yes: bool,
) -> bool:
    """Tell a person what will move and ask, unless nothing has to move; return whether to go on."""
    todo = [name for name, one in collections.items() if len(one.kept(spheres_file(folder, name))) < len(one.q_cmd)]
    if not todo:
        return True
    about = about_motion("collection for a calibration", robot, station, todo)
    if not agreed(robot, about, enable_motion=enable_motion, yes=yes):
        return True
    question = f"{' and '.join(todo)}: are the spheres on, is the table clear, and may the arms move?"
    return typer.confirm(question, err=True)


def _on_robot(
    robot: str, station: Station, collection: RobotCollection, path: Path, listen: Callable[[int, int], None]
) -> NDArray[np.float64]:
    """Collect the rows that are missing; return the centres (n, k, 3) of all rows."""
    from trocar.hardware.kinds import robot_of

    if len(collection.kept(path)) < len(collection.q_cmd):
        with robot_of(robot)[0].connect(station, None) as laboratory:
            try:
                laboratory.run(lambda cell: collection.collect(cell, path, listen), float("inf"))
            except TrocarError:
                beside().print(f"{path} has what was collected; the same command continues", soft_wrap=True)
                raise
    return np.array(collection.kept(path))


def _check_fit(model: str, fraction: float, rows: int) -> None:
    from trocar.calibration.models import MODELS
    from trocar.calibration.models.base import MIN_ROWS

    MODELS.pick(model)
    if model == "lstm":
        need("learn")
    least = 2 * MIN_ROWS
    if not 0.0 < fraction < 1.0 or fraction * rows < least or (1 - fraction) * rows < 1:
        problem = f"leaves too few to fit on ({least} or more) or to evaluate on (1)"
        raise InvalidInput(f"--fraction {fraction:g} of {rows} rows", problem, "give another share, or more --rows")
