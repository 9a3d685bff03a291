"""``trocar station export``: a station for MuJoCo's own viewer, its arms for ROS."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trocar.cli.extras import need
from trocar.cli.plugin import Plugins
from trocar.errors import TrocarError
from trocar.files.output import make_folder, require_place, write_text

if TYPE_CHECKING:
    from trocar.lab import Station

MJCF, URDF = "MJCF of a station", "URDF of an arm"


def export(
    station: Annotated[str, typer.Argument(metavar="STATION", help="Name of a built-in station, or a TOML file.")],
    *,
    mjcf: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the whole station for MuJoCo (.xml); needs extra 'sim'.")
    ] = None,
    urdf: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Write each type of arm there as URDF.")] = None,
    task: Annotated[
        str, typer.Option(metavar="TASK", help="Put the objects of this task on the table.", show_default="nothing")
    ] = "",
    seed: Annotated[int, typer.Option(help="Seed of the task's scene.")] = 0,
    plugin: Plugins = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Write a station as models for other programs: MJCF with named actuators and sensors, URDF of its arms.

    They are the nominal laboratory: bases as the file has them, joints that follow their commands, no cables, no flaws.
    """
    from trocar.lab import load_station  # SciPy only when needed

    del plugin  # loaded when it was parsed
    if mjcf is None and urdf is None:
        raise TrocarError("there is nothing to write; give --mjcf FILE.xml, --urdf FOLDER, or both")
    if task and mjcf is None:
        raise TrocarError("--task is for the whole station; give --mjcf FILE.xml too")
    if seed < 0:
        raise TrocarError(f"seed {seed} is negative; give 0 or more")
    if mjcf is not None:
        need("sim", "mujoco", "trio", "cv2")
        if mjcf.suffix != ".xml" or not mjcf.parent.is_dir():
            raise TrocarError(f"file {str(mjcf)!r} must end in .xml and lie in a folder that exists")
        require_place(mjcf, MJCF, [station])
    found = load_station(station)
    files = [] if mjcf is None else [write_text(mjcf, f"{_mjcf(found, task, seed)}\n", MJCF)]
    files += [] if urdf is None else _write_urdf(found, urdf)
    if as_json:
        typer.echo(json.dumps({"station": found.name, "files": [str(file) for file in files]}))
        return
    for file in files:
        typer.echo(f"wrote {file}")
    if mjcf is not None:
        typer.echo(f"open it: python -m mujoco.viewer --mjcf={mjcf}; load its key 'park', where the arms rest")


def _mjcf(station: Station, task: str, seed: int) -> str:
    import numpy as np

    from trocar.eval import TASKS
    from trocar.sim.station_model import station_mjcf  # the simulator is heavy

    if not task:
        return station_mjcf(station)
    chosen = TASKS.pick(task)()
    there = chosen.at(station)
    return station_mjcf(there, chosen.world(chosen.scene(np.random.default_rng(seed), there)))


def _write_urdf(station: Station, folder: Path) -> list[Path]:
    """Write one file for each type of arm, named after it."""
    from trocar.arms.urdf import arm_urdf

    types = {arm.name: arm for arm in station.models.values()}
    make_folder(folder)
    return [write_text(folder / f"{name}.urdf", arm_urdf(arm), URDF) for name, arm in types.items()]
