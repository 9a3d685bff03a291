"""``trocar calibrate collect``: images of spheres on a moving arm, registration, cable model, report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from trocar.cli.calibrate import require_box
from trocar.cli.group import Result
from trocar.cli.options import Flaws, Level, Seed, StationName, need
from trocar.cli.out_folder import default_folder, differing
from trocar.cli.progress import progress
from trocar.cli.terminal import beside
from trocar.errors import InvalidInput
from trocar.files.output import make_folder, write_json, write_text

if TYPE_CHECKING:
    from trocar.collect.collection import Collection
    from trocar.lab.flaws import Difficulty

SESSION, COLLECTION, FIT = range(3)
"""Streams of randomness under the seed."""


def collect(
    station: StationName,
    *,
    arm: Annotated[
        list[str] | None, typer.Option(metavar="ARM", help="Which arm; may be given several times.", show_default="all")
    ] = None,
    rows: Annotated[int, typer.Option(help="Samples of each arm; the paper has 1355.")] = 1355,
    seed: Seed = 0,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the files; default out/calibration-STATION-SEED-OPTIONS."),
    ] = None,
    fit: Annotated[bool, typer.Option(help="Also fit a cable model, and evaluate it on the rows left out.")] = True,
    model: Annotated[str, typer.Option(help="Cable model: offset, ridge, play, lstm (extra 'learn').")] = "play",
    fraction: Annotated[float, typer.Option(help="First share of the rows that the model is fitted on.")] = 0.8,
    difficulty: Level = "recorded",
    flaw: Flaws = None,
) -> Result:
    """Calibrate arms of the simulated cell from images of spheres that they wear: joints, bases, cable models.

    Interrupted, it keeps what it has; run the same command to continue.
    """
    need("sim", "mujoco", "cv2")
    given = {"rows": rows, "fit": fit, "model": model, "fraction": fraction, "difficulty": difficulty, "flaw": flaw}
    folder = out or default_folder(f"calibration-{Path(station).stem}-{seed}", differing(collect, given))
    from trocar.collect.report import collection_table  # slow to import
    from trocar.lab.flaws import Difficulty

    collections = _collections(station, arm, rows, seed, Difficulty.of(difficulty, flaw or ()))
    if fit:
        _check_fit(model, fraction, rows)
    make_folder(folder)
    try:
        summary, files = _chain(station, collections, folder, model if fit else None, fraction, seed)
    except KeyboardInterrupt:
        beside().print(f"stopped; what was collected is in {folder}; run the same command to continue")
        raise typer.Exit(130) from None
    return Result(summary, ["files: " + ", ".join(map(str, files))], [collection_table(summary["arms"])])


def _check_fit(model: str, fraction: float, rows: int) -> None:
    from trocar.calibration.models import MODELS
    from trocar.calibration.models.base import MIN_ROWS

    MODELS.pick(model)
    if model == "lstm":
        need("learn", "jax", "equinox", "optax")
    least = 2 * MIN_ROWS
    if not 0.0 < fraction < 1.0 or fraction * rows < least or (1 - fraction) * rows < 1:
        raise InvalidInput(
            f"--fraction {fraction:g} of {rows} rows",
            f"leaves too few to fit on ({least} or more) or to evaluate on (1)",
            "give another share, or more --rows",
        )


def _collections(
    name: str, arms: list[str] | None, rows: int, seed: int, difficulty: Difficulty
) -> dict[str, Collection]:
    from trocar.collect.collection import Collection  # the simulator is heavy
    from trocar.lab import load_station, require_reach
    from trocar.lab.session import draw_session

    station = replace(load_station(name), difficulty=difficulty).require_relevant()
    require_reach(station)
    session = draw_session(station, np.random.default_rng([seed, SESSION]))
    found = {}
    for arm in dict.fromkeys(arms or station.arms):
        box = require_box(station.name, arm, station.arm(arm))
        place = list(station.arms).index(arm)
        found[arm] = Collection(session, arm, box, np.random.SeedSequence([seed, COLLECTION, place]), rows)
    return found


def _chain(
    station: str, collections: dict[str, Collection], folder: Path, model: str | None, fraction: float, seed: int
) -> tuple[dict[str, Any], list[Path]]:
    """Run the whole chain for each arm; return the figures and the files."""
    from trocar.calibration.figure import draw_evaluation  # slow to import
    from trocar.collect.chain import calibrate
    from trocar.collect.report import draw_calibration
    from trocar.lab import station_text
    from trocar.lab.station_file import with_registered

    figures: dict[str, Any] = {}
    files: list[Path] = []
    bases = {}
    with progress() as tick:
        for arm, collection in collections.items():
            tick(f"images of {arm}", 0, len(collection.q_cmd))
        for number, (arm, collection) in enumerate(collections.items()):

            def listen(done: int, total: int, arm: str = arm) -> None:
                tick(f"images of {arm}", done, total)

            rng = np.random.default_rng([seed, FIT, number])
            found = calibrate(collection, folder, model=model, fraction=fraction, rng=rng, listener=listen)
            figures[arm] = found.summary(collection.T_camera_base_true)
            bases[arm] = collection.T_world_camera_registered @ found.measured.hand_eye.T_camera_base
            files += [folder / f"recording_{arm}.npz", draw_calibration(found, folder / f"calibration_{arm}.png")]
            if found.evaluation is not None:
                files += [folder / f"cables_{arm}.npz", draw_evaluation(found.evaluation, folder / f"loops_{arm}.png")]
    summary = {"station": station, "seed": seed, "arms": figures}
    report, text = folder / "report.json", folder / "station.toml"
    write_json(report, summary, "report of a calibration")
    write_text(text, with_registered(station_text(station), bases), "station")
    return summary, [*files, text, report]
