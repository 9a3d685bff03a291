"""Groups of commands that hold one line per member and import a command only when it is called.

Other packages can add theirs by entry points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from trocar.cli.grouped import GroupedCommand
from trocar.cli.quiet import quiet_option
from trocar.registry import Lazy, Registry


@dataclass(frozen=True)
class Known:
    """What is known of a command before it is imported.

    Attributes:
        about: one line for the list of commands; for a group, all that its help says.
        where: ``module:name`` of its function, or of a Typer app; empty for a group.
        example: a line that calls it.
        members: of a group, by name.
    """

    about: str
    where: str = ""
    example: str = ""
    members: Mapping[str, Known] = field(default_factory=dict)


COMMANDS: Registry[typer.Typer | Known] = Registry("command", "trocar.commands")
"""Commands from elsewhere as ``GROUP.NAME``: what is known of one, or a Typer app of it. Tasks add theirs this way."""


class Deferred(TyperCommand):
    """A command known by name and one line, imported when it is needed.

    Contexts and commands are Click's, which typer ships under a name that depends on its version: hence ``Any``.
    """

    def __init__(self, name: str, about: str, load: Callable[[], Any]) -> None:
        """Take the name, the line, and a function that returns the command itself."""
        super().__init__(name, callback=None, help=about)
        self.load = load

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Return the context of the command itself: it is what parses, completes and is invoked."""
        return self.load().make_context(info_name, args, parent, **extra)

    def get_short_help_str(self, limit: int = 45) -> str:
        """Return the whole line."""
        del limit
        return self.help or ""


class OpenGroup(TyperGroup):
    """A group of known members that also has the commands registered under its name.

    Attributes:
        members: by name; set by a subclass, or by the code that makes the group.
    """

    members: Mapping[str, Known]

    def __init__(self, *, members: Mapping[str, Known] | None = None, **rest: Any) -> None:
        super().__init__(**rest)
        if members is not None:
            self.members = members

    def get_short_help_str(self, limit: int = 45) -> str:
        """Return its whole description."""
        del limit
        return self.help or ""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        prefix = f"{self.name}."
        added = [name.removeprefix(prefix) for name in COMMANDS if name.startswith(prefix)]
        return [*self.members, *added]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command: a group, a placeholder for a known command, or an imported one from another package."""
        name = f"{self.name}.{cmd_name}"
        known = self.members.get(cmd_name) or (COMMANDS[name] if name in COMMANDS else None)
        if not isinstance(known, Known):
            return known and command_of(cmd_name, known)
        if known.members:
            return OpenGroup(
                name=cmd_name, members=known.members, help=known.about, no_args_is_help=True, rich_markup_mode=None
            )
        return Deferred(cmd_name, known.about, lambda: command_of(cmd_name, Lazy(known.where).load(), known.example))


def command_of(name: str, found: Callable[..., None] | typer.Typer, example: str = "") -> Any:
    """Return the command of a function or of a Typer app, with the options that every command has.

    Args:
        name: of the command.
        found: the function, with its options as parameters, or the app.
        example: a line that calls it; an app has its own.
    """
    app = found
    if not isinstance(app, typer.Typer):
        app = typer.Typer(rich_markup_mode=None, add_completion=False)
        app.command(name, cls=GroupedCommand, epilog=f"Example: {example}")(found)
    made: Any = get_command(app)
    made.name = name
    if not isinstance(made, TyperGroup):
        made.params.append(quiet_option())
    return made
