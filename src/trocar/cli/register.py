"""``trocar register``: poses from points."""

from __future__ import annotations

import typer

from trocar.cli.open_group import OpenGroup
from trocar.cli.register_points import points

app = typer.Typer(
    cls=OpenGroup,
    help="Find poses from points: a robot's in a camera, a block's in a capture.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
app.command(epilog="Example: trocar register points robot.npy camera.npy --json")(points)


@app.callback()
def register() -> None:
    """Find poses from points: a robot's in a camera, a block's in a capture."""
