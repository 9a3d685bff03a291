"""``trocar register cell``: lenses, camera and bases from images of a checkerboard."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from trocar.cli.extras import need
from trocar.cli.out_folder import check_out_folder
from trocar.cli.plugin import Plugins
from trocar.cli.progress import progress
from trocar.cli.terminal import details, results
from trocar.errors import TrocarError
from trocar.files.output import PICTURE, make_folder, write_json, write_text

if TYPE_CHECKING:
    from trocar.collect.checkerboard import CellRegistration

STATION, REPORT = "station", "report of a registration"
FILES = {"station.toml": STATION, "report.json": REPORT, "corners.png": PICTURE}
"""The files that are written, with their kinds."""


def cell(
    station: Annotated[str, typer.Argument(metavar="STATION", help="Name of a station, or a TOML file.")],
    *,
    seed: Annotated[int, typer.Option(help="Seed of everything random: the hand, the brackets, the images.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the files; default out/registration-STATION-SEED.")
    ] = None,
    plugin: Plugins = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Register a simulated cell with a checkerboard: lenses, camera and bases; print errors against the truth."""
    need("sim", "mujoco", "cv2")
    del plugin  # loaded when it was parsed
    if seed < 0:
        raise TrocarError(f"seed {seed} is negative; give 0 or more")
    folder = out or Path("out") / f"registration-{Path(station).stem}-{seed}"
    check_out_folder(folder, FILES, [station])
    began = time.perf_counter()
    found = _register(station, seed)
    summary = {"station": station, "seed": seed, **found.summary()}
    files = _write(found, station, summary, folder)
    if as_json:
        typer.echo(json.dumps(summary))
        return
    from trocar.collect.checkerboard_report import registration_table  # slow to import

    details().print(registration_table(summary))
    views = f"{summary['views_used']} of {summary['views_shown']} views"
    results().print(
        f"lenses from {views}: {summary['lenses_rms_px']:.3f} px RMS; {summary['minutes_of_a_person']:.0f} min of a "
        f"person's time; computed in {time.perf_counter() - began:.0f} s",
        soft_wrap=True,
    )
    results().print("files: " + ", ".join(map(str, files)), soft_wrap=True)


def _register(station: str, seed: int) -> CellRegistration:
    from trocar.collect.checkerboard import checkerboard_of, register_cell  # the simulator is heavy
    from trocar.lab import load_station

    loaded = load_station(station)
    checkerboard_of(loaded)  # raises before a progress bar is drawn
    with progress() as tick:

        def listen(done: int, total: int) -> None:
            tick("images of the board", done, total)

        return register_cell(loaded, np.random.SeedSequence(seed), listener=listen)


def _write(found: CellRegistration, station: str, summary: dict[str, Any], folder: Path) -> list[Path]:
    """Write station, report and picture; return their paths."""
    from trocar.collect.checkerboard_report import draw_registration
    from trocar.lab import station_text
    from trocar.lab.registered import with_registered

    text, report, picture = (folder / name for name in FILES)
    cameras = {found.camera: (found.T_world_camera, found.calibration.rig)}
    written = with_registered(station_text(station), found.T_world_base, cameras)
    make_folder(folder)
    write_text(text, written, STATION)
    write_json(report, summary, REPORT)
    return [text, report, draw_registration(found, picture)]
