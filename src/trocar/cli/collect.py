"""``trocar calibrate collect``: images of spheres on a moving arm, registration, cable model, report."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer import Option

from trocar.cli.group import Result
from trocar.cli.options import Seed, StationName, need
from trocar.cli.out_folder import default_folder, differing
from trocar.cli.progress import progress
from trocar.cli.terminal import beside
from trocar.errors import InvalidInput
from trocar.eval.config import RunConfig
from trocar.files.output import make_folder, write_json, write_text

SESSION, COLLECTION, FIT = range(3)
"""Streams of randomness under the seed."""
OF_RUN = {field.name: field.metadata for field in fields(RunConfig)}
Flaws = Annotated[list[str] | None, Option(metavar=OF_RUN["flaws"]["metavar"], help=OF_RUN["flaws"]["help"])]
ABOUT_OUT = "Folder for the files; default out/calibration-STATION-SEED-OPTIONS."


def collect(
    station: StationName,
    *,
    arm: Annotated[
        list[str] | None, Option(metavar="ARM", help="Which arm; may be given several times.", show_default="all")
    ] = None,
    rows: Annotated[int, Option(help="Samples of each arm; the paper has 1355.")] = 1355,
    seed: Seed = 0,
    out: Annotated[Path | None, Option(metavar="DIR", help=ABOUT_OUT)] = None,
    fit: Annotated[bool, Option(help="Also fit a cable model, and evaluate it on the rows left out.")] = True,
    model: Annotated[str, Option(help="Cable model: offset, ridge, play, lstm (extra 'learn').")] = "play",
    fraction: Annotated[float, Option(help="First share of the rows that the model is fitted on.")] = 0.8,
    difficulty: Annotated[str, Option(help=OF_RUN["difficulty"]["help"])] = "recorded",
    flaw: Flaws = None,
) -> Result:
    """Calibrate arms of the simulated cell from images of spheres that they wear: joints, bases, cable models.

    Interrupted, it keeps what it has; run the same command to continue.
    """
    need("sim")
    given = {"rows": rows, "fit": fit, "model": model, "fraction": fraction, "difficulty": difficulty, "flaw": flaw}
    folder = out or default_folder(f"calibration-{Path(station).stem}-{seed}", differing(collect, given))
    from trocar.calibration.evaluation import draw_evaluation
    from trocar.collect.chain import calibrate, collection_table, draw_calibration
    from trocar.collect.collection import Collection  # the simulator is heavy
    from trocar.lab import load_station, require_reach, station_text
    from trocar.lab.flaws import Difficulty
    from trocar.lab.session import draw_session
    from trocar.lab.station_file import with_registered

    loaded = replace(load_station(station), difficulty=Difficulty.of(difficulty, flaw or ())).require_relevant()
    require_reach(loaded)
    session = draw_session(loaded, np.random.default_rng([seed, SESSION]))
    collections = {}
    for name in dict.fromkeys(arm or loaded.arms):
        box = loaded.calibration_box(name)
        seeds = np.random.SeedSequence([seed, COLLECTION, list(loaded.arms).index(name)])
        collections[name] = Collection(session, name, box, seeds, rows)
    if fit:
        _check_fit(model, fraction, rows)
    make_folder(folder)
    figures: dict[str, Any] = {}
    files, bases = [], {}
    try:
        with progress() as tick:
            for name, collection in collections.items():
                tick(f"images of {name}", 0, len(collection.q_cmd))
            for number, (name, collection) in enumerate(collections.items()):

                def listen(done: int, total: int, name: str = name) -> None:
                    tick(f"images of {name}", done, total)

                rng, kind = np.random.default_rng([seed, FIT, number]), model if fit else None
                found = calibrate(collection, folder, model=kind, fraction=fraction, rng=rng, listener=listen)
                figures[name] = found.summary(collection.T_camera_base_true)
                bases[name] = collection.T_world_camera_registered @ found.measured.T_camera_base
                files += [folder / f"recording_{name}.npz", draw_calibration(found, folder / f"calibration_{name}.png")]
                if found.evaluation is not None:
                    loops = draw_evaluation(found.evaluation, folder / f"loops_{name}.png")
                    files += [folder / f"cables_{name}.npz", loops]
    except KeyboardInterrupt:
        beside().print(f"stopped; what was collected is in {folder}; run the same command to continue")
        raise typer.Exit(130) from None
    summary = {"station": station, "seed": seed, "arms": figures}
    report, text = folder / "report.json", folder / "station.toml"
    write_json(report, summary, "report of a calibration")
    write_text(text, with_registered(station_text(station), bases), "station")
    files += [text, report]
    return Result(summary, ["files: " + ", ".join(map(str, files))], [collection_table(figures)])


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
