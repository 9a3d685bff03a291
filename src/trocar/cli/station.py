"""``trocar station``: what a laboratory is."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from trocar.cli.plugin import Plugins
from trocar.cli.terminal import results
from trocar.counting import counted

if TYPE_CHECKING:
    from trocar.geometry import SE3
    from trocar.lab import Station

Name = Annotated[str, typer.Argument(metavar="STATION", help="Name of a built-in station, or a TOML file.")]
JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def list_stations(*, as_json: JsonFlag = False) -> None:
    """List the stations that come with the package."""
    from trocar.lab import built_in_stations, load_station  # SciPy only when needed

    stations = {name: load_station(name).about for name in built_in_stations()}
    if as_json:
        typer.echo(json.dumps(stations))
        return
    for name, about in stations.items():
        typer.echo(f"{name}: {about}")


def show(
    station: Name,
    *,
    toml: Annotated[bool, typer.Option("--toml", help="Print the file itself, to start your own from.")] = False,
    plugin: Plugins = None,
    as_json: JsonFlag = False,
) -> None:
    """Show what a station consists of."""
    from trocar.lab import load_station, station_text

    del plugin  # loaded when it was parsed
    found = load_station(station)
    if toml:
        typer.echo(station_text(station), nl=False)
    elif as_json:
        typer.echo(json.dumps(_values(found)))
    else:
        _show(found)


def check(station: Name, *, plugin: Plugins = None, as_json: JsonFlag = False) -> None:
    """Check keys, values, reach, distances between arms and what cameras see; exit code 1 if something is wrong."""
    from trocar.lab import check_station, load_station

    del plugin  # loaded when it was parsed
    found = load_station(station)
    wrong = check_station(found)
    if as_json:
        typer.echo(json.dumps({"station": found.name, "ok": not wrong, "findings": wrong}))
    else:
        for sentence in wrong:
            typer.echo(sentence)
        typer.echo(f"{found.name}: {counted(len(wrong), 'finding')}" if wrong else f"{found.name}: all is well")
    if wrong:
        raise typer.Exit(1)


def _show(station: Station) -> None:
    console = results()
    table = Table(title=f"{station.name}: {station.about}")
    for column in ("arm", "model", "instrument", "transmission", "base x y z mm"):
        table.add_column(column)
    for name, arm in station.arms.items():
        table.add_row(name, arm.model.name, arm.model.instrument.name, arm.transmission_name, _mm(arm.T_world_base))
    console.print(table)
    for name, camera in _values(station)["cameras"].items():
        console.print(f"camera {name}: {camera['kind']}, at {_mm(station.cameras[name].T_world_camera)} mm")
    for name, T in station.T_world_fixture.items():
        console.print(f"fixture {name}: at {_mm(T)} mm")
    console.print(f"registration of bases: {station.registration.about}")
    level = ", ".join([station.difficulty.level, *station.difficulty.named])
    console.print(f"difficulty: {level}; --json has the size of every flaw")


def _values(station: Station) -> dict[str, Any]:
    from trocar.perception.image import StereoRig

    return {
        "name": station.name,
        "about": station.about,
        "arms": {
            name: {
                "model": arm.model.name,
                "instrument": arm.model.instrument.name,
                "transmission": arm.transmission_name,
                "T_world_base": arm.T_world_base.matrix.tolist(),
            }
            for name, arm in station.arms.items()
        },
        "cameras": {
            name: {
                "kind": "stereo" if isinstance(camera.model, StereoRig) else "rgbd",
                "T_world_camera": camera.T_world_camera.matrix.tolist(),
            }
            for name, camera in station.cameras.items()
        },
        "T_world_fixture": {name: T.matrix.tolist() for name, T in station.T_world_fixture.items()},
        "min_distance_m": station.min_distance_m,
        "flaws": station.flaws(),
    }


def _mm(T: SE3) -> str:
    return " ".join(f"{1e3 * value:.1f}" for value in T.translation_m)
