"""``trocar study suture-setup``: which circles arms can sew with which needles, from where."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

from trocar.arms import ARMS
from trocar.cli.group import Result
from trocar.cli.out_folder import check_out_folder
from trocar.cli.progress import progress
from trocar.cli.terminal import rich_table
from trocar.errors import UnknownName
from trocar.files.output import PICTURE, write_json
from trocar.tasks.suture.commands import options
from trocar.tasks.suture.planning import NEEDLES, PRESETS, SutureSetup
from trocar.tasks.suture.planning.settings import SETTINGS, setting_of, settings_between, with_settings
from trocar.tasks.suture.planning.setup_map import SetupMap

KIND = "maps of setups for sutures"
FILES = {"summary.json": KIND, "suture_setups.png": PICTURE}
"""The files that are written, with their kinds."""
AROUND = tuple(name for name in SETTINGS if name.startswith(("wall_", "puller_")))
USUAL_ARMS, USUAL_NEEDLES = ("psm-classic", "raven2-left"), ("RB-1", "SH", "UR-6", "CT-1")


def setups(
    *,
    arm: Annotated[
        list[str] | None, typer.Option(help=f"Arm, repeatable: {', '.join(ARMS)}; default: {', '.join(USUAL_ARMS)}.")
    ] = None,
    needle: Annotated[
        list[str] | None,
        typer.Option(help=f"Needle, repeatable: {', '.join(NEEDLES)}; default: {', '.join(USUAL_NEEDLES)}."),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help=f"Body wall or second port, for a base in the direction of x; repeatable. Names: {', '.join(AROUND)}.",
        ),
    ] = None,
    out: options.Out = None,
) -> Result:
    """Draw which circles arms can sew with needles of the catalogue, as maps over the place of the base.

    A circle can be sewn if every position round it can, in one direction at least. The primitive is scaled with the
    needle; spin of the base and grasp are the best of those that are tried. Takes 20 s for an arm and a needle.
    """
    from trocar.tasks.suture.planning.setup_map import setup_map

    names = [(a, n) for a in arm or USUAL_ARMS for n in needle or USUAL_NEEDLES]
    for a, n in names:
        for what, name, known in (("the arm", a, ARMS), ("the needle", n, NEEDLES)):
            if name not in known:
                raise UnknownName(what, name, known)
    given = dict(setting_of(text) for text in settings or ())
    for name in given:
        if name not in AROUND:
            raise UnknownName("the setting", name, AROUND)
    around = with_settings(PRESETS["default"], given).setup
    check_out_folder(out, FILES)
    maps: dict[tuple[str, str], SetupMap] = {}
    with progress() as tick:
        for number, (a, n) in enumerate(names):
            maps[a, n] = setup_map(
                ARMS[a],
                NEEDLES[n],
                wall=around.wall,
                puller=around.puller,
                progress=lambda done, total, number=number: tick("places", number * total + done, len(names) * total),
            )
    summary: dict[str, Any] = {"maps": [_values(*name, found) for name, found in maps.items()]}
    if out is not None:
        from trocar.tasks.suture.report.setup_maps import draw_maps

        files = [out / "summary.json", draw_maps(maps, out / "suture_setups.png")]
        summary["files"] = [str(file) for file in files]
        write_json(out / "summary.json", summary, KIND)
    return Result(summary, _lines(summary))


def _values(arm: str, needle: str, found: SetupMap) -> dict[str, Any]:
    best = found.best
    return {
        "arm": arm,
        "needle": needle,
        "sideways_mm": (1e3 * found.sideways_m).round(6).tolist(),
        "up_mm": (1e3 * found.up_m).round(6).tolist(),
        "radius_mm": (1e3 * found.radius_m).round(6).tolist(),
        "largest_mm": None if best is None else 1e3 * best.circle.radius_m,
        "places": len(found.setups),
        "command": None if best is None else _command(needle, best),
    }


def _command(needle: str, setup: SutureSetup) -> str | None:
    """Return the command that plans in a setup; None if settings cannot describe its base."""
    preset = with_settings(PRESETS["default"], {"needle": needle, "pushes": 0, "grasp_behind_tip_deg": 0})
    changes = settings_between(preset.setup, setup)
    again = with_settings(preset, changes, setup.arm.name).setup
    if not np.allclose(again.T_base_circle.matrix, setup.T_base_circle.matrix, atol=1e-6):
        return None
    words = [f"--arm {setup.arm.name}", f"--set needle={needle}", *(f"--set {a}={b}" for a, b in changes.items())]
    return " ".join(["trocar plan suture", *words])


def _lines(summary: dict[str, Any]) -> list[Any]:
    """Return the largest circles, and where to plan them, to be printed."""
    rows = []
    for found in summary["maps"]:
        places = f"{found['places']} of {len(found['up_mm']) * len(found['sideways_mm'])}"
        largest = "-" if found["largest_mm"] is None else f"{found['largest_mm']:.0f}"
        rows.append((found["arm"], found["needle"], places, largest))
    columns = ("arm", "needle", "places of the base", "largest circle, mm")
    commands = [found["command"] for found in summary["maps"] if found["command"]]
    return [
        rich_table("Circles that can be sewn all round", columns, rows, text=2),
        *(f"to plan there: {command}" for command in commands),
        *options.files_line(summary),
    ]
