"""``trocar station``: what a laboratory is, and its models for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from trocar.cli.group import Result
from trocar.cli.options import Seed, StationName, need
from trocar.cli.out_folder import require_file
from trocar.counting import counted
from trocar.errors import InvalidInput
from trocar.files.output import make_folder, write_text

if TYPE_CHECKING:
    from trocar.geometry import SE3
    from trocar.lab import Station

MJCF, URDF = "MJCF of a station", "URDF of an arm"


def list_stations() -> Result:
    """List the stations that come with the package."""
    from trocar.lab import built_in_stations, load_station  # SciPy only when needed

    stations = {name: load_station(name).about for name in built_in_stations()}
    return Result(stations, [f"{name}: {about}" for name, about in stations.items()])


def show(
    station: StationName,
    *,
    toml: Annotated[bool, Option("--toml", help="Print the file itself, to start your own from.")] = False,
) -> Result:
    """Show what a station consists of."""
    from trocar.lab import load_station, station_text

    found = load_station(station)
    if toml:
        return Result({"toml": station_text(station)}, [station_text(station).removesuffix("\n")])
    values = _values(found)
    lines = [f"{found.name}: {found.about}"]
    for name, arm in found.arms.items():
        lines += [
            f"arm {name}: {arm.model.name} with {arm.model.instrument.name}, base at {_mm(arm.T_world_base)} mm",
            f"  cables {arm.transmission_name}; at most {arm.speeds}",
        ]
    for name, camera in found.cameras.items():
        lines.append(f"camera {name}: {values['cameras'][name]['kind']}, at {_mm(camera.T_world_camera)} mm")
    lines += [f"fixture {name}: at {_mm(T)} mm" for name, T in found.T_world_fixture.items()]
    level = ", ".join([found.difficulty.level, *found.difficulty.named])
    lines += [
        f"registration of bases: {found.registration.about}",
        f"difficulty: {level}; --json has the size of every flaw",
    ]
    return Result(values, lines)


def check(station: StationName) -> Result:
    """Check keys, values, reach, distances between arms and what cameras see; exit code 1 if something is wrong."""
    from trocar.lab import check_station, load_station

    found = load_station(station)
    wrong = check_station(found)
    end = counted(len(wrong), "finding") if wrong else "all is well"
    summary = {"station": found.name, "ok": not wrong, "findings": wrong}
    return Result(summary, [*wrong, f"{found.name}: {end}"], succeeded=not wrong)


def export(
    station: StationName,
    *,
    mjcf: Annotated[
        Path | None, Option(metavar="FILE", help="Write the whole station for MuJoCo (.xml); needs extra 'sim'.")
    ] = None,
    urdf: Annotated[Path | None, Option(metavar="FOLDER", help="Write each type of arm there as URDF.")] = None,
    task: Annotated[
        str, Option(metavar="TASK", help="Put the objects of this task on the table.", show_default="nothing")
    ] = "",
    seed: Seed = 0,
) -> Result:
    """Write a station as models for other programs: MJCF with named actuators and sensors, URDF of its arms.

    They are the nominal laboratory: bases as the file has them, joints that follow their commands, no cables, no flaws.
    The MJCF's key 'park' is where the arms rest.
    """
    from trocar.arms.urdf import arm_urdf  # SciPy only when needed
    from trocar.lab import load_station

    if mjcf is None and urdf is None:
        remedy = "give --mjcf FILE.xml, --urdf FOLDER, or both"
        raise InvalidInput("trocar station export", "has nothing to write", remedy)
    if task and mjcf is None:
        raise InvalidInput("--task", "is for the whole station", "give --mjcf FILE.xml too")
    if mjcf is not None:
        need("sim")
        require_file("--mjcf", mjcf, MJCF, (".xml",), [station])
    found, files = load_station(station), []
    if mjcf is not None:
        files.append(write_text(mjcf, f"{_mjcf(found, task, seed)}\n", MJCF))
    if urdf is not None:
        make_folder(urdf)
        types = {arm.name: arm for arm in found.models.values()}
        files += [write_text(urdf / f"{name}.urdf", arm_urdf(arm), URDF) for name, arm in types.items()]
    lines = [f"wrote {file}" for file in files]
    if mjcf is not None:
        lines.append(f"open it: python -m mujoco.viewer --mjcf={mjcf}; load its key 'park', where the arms rest")
    return Result({"station": found.name, "files": [str(file) for file in files]}, lines)


def _mjcf(station: Station, task: str, seed: int) -> str:
    import numpy as np

    from trocar.eval import TASKS
    from trocar.eval.staged import draw_world
    from trocar.sim.station_model import station_mjcf  # the simulator is heavy

    if not task:
        return station_mjcf(station)
    chosen = TASKS.pick(task)()
    there = chosen.at(station)
    return station_mjcf(there, draw_world(chosen, np.random.default_rng(seed), there))


def _values(station: Station) -> dict[str, Any]:
    from trocar.perception.image import StereoRig

    arms, cameras = {}, {}
    for name, arm in station.arms.items():
        names = {
            "model": arm.model.name,
            "instrument": arm.model.instrument.name,
            "transmission": arm.transmission_name,
        }
        arms[name] = {**names, "T_world_base": arm.T_world_base.matrix.tolist()}
    for name, camera in station.cameras.items():
        kind = "stereo" if isinstance(camera.model, StereoRig) else "rgbd"
        cameras[name] = {"kind": kind, "T_world_camera": camera.T_world_camera.matrix.tolist()}
    return {
        "name": station.name,
        "about": station.about,
        "arms": arms,
        "cameras": cameras,
        "T_world_fixture": {name: T.matrix.tolist() for name, T in station.T_world_fixture.items()},
        "min_distance_m": station.min_distance_m,
        "flaws": station.flaws(),
    }


def _mm(T: SE3) -> str:
    return " ".join(f"{1e3 * value:.1f}" for value in T.translation_m)
