"""``trocar register``: poses from points and images."""

from __future__ import annotations

import typer

from trocar.cli.open_group import OpenGroup
from trocar.cli.register_cell import cell
from trocar.cli.register_points import points

app = typer.Typer(
    cls=OpenGroup,
    help="Find poses: a robot's in a camera, a block's in a capture, a whole cell's from a checkerboard.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
app.command(epilog="Example: trocar register points robot.npy camera.npy --json")(points)
app.command(epilog="Example: trocar register cell raven-pair --seed 3 --out out/cell")(cell)


@app.callback()
def register() -> None:
    """Find poses: a robot's in a camera, a block's in a capture, a whole cell's from a checkerboard."""
