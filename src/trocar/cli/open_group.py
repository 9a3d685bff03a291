"""Groups of commands to which other packages can add theirs, by entry points."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from trocar.registry import Registry

COMMANDS: Registry[typer.Typer] = Registry("command", "trocar.commands")
"""Commands from elsewhere as ``GROUP.NAME``: Typer apps of one command each. A task brings its own commands so."""


class OpenGroup(TyperGroup):
    """A group that also has the commands registered under its name.

    Contexts and commands are Click's, which typer brings along under a name that depends on its version.
    """

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        prefix = f"{self.name}."
        added = [name.removeprefix(prefix) for name in COMMANDS if name.startswith(prefix)]
        return [*super().list_commands(ctx), *added]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, loading it if it comes from elsewhere."""
        found = super().get_command(ctx, cmd_name)
        name = f"{self.name}.{cmd_name}"
        if found is None and name in COMMANDS:
            found = get_command(COMMANDS[name])
            found.name = cmd_name
        return found
