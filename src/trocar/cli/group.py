"""Groups of commands, each imported when it is called, and the options and the printing that all commands share.

A command is a function whose parameters are its options. It returns a :class:`Result`, which is printed as text or,
with ``--json``, as one JSON object; so no command prints for itself. Other packages add commands by entry points.
"""

from __future__ import annotations

import inspect
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from trocar.cli.options import JsonFlag, Plugins, quiet_option
from trocar.cli.terminal import details, results
from trocar.errors import InvalidValue, UnknownName
from trocar.registry import Lazy, Registry

if TYPE_CHECKING:
    from rich.console import RenderableType


@dataclass(frozen=True)
class Result:
    """What a command found.

    Attributes:
        summary: printed with ``--json``.
        lines: sentences and tables, printed otherwise.
        details: printed before them, but not with ``--quiet``.
        succeeded: whether the exit code is 0; else 1.
    """

    summary: Mapping[str, Any]
    lines: Sequence[RenderableType] = ()
    details: Sequence[RenderableType] = ()
    succeeded: bool = True

    def show(self, as_json: bool) -> None:
        """Print it, and end with exit code 1 if it did not succeed."""
        if as_json:
            sys.stdout.write(json.dumps(self.summary) + "\n")
        else:
            for console, parts in ((details(), self.details), (results(), self.lines)):
                for part in parts:
                    console.print(part, markup=False, highlight=False, soft_wrap=isinstance(part, str))
        if not self.succeeded:
            raise typer.Exit(1)


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


COMMANDS: Registry[Known | typer.Typer] = Registry("command", "trocar.commands")
"""Commands from elsewhere as ``GROUP.NAME``. Tasks add their own commands this way."""


class Command(TyperCommand):
    """A command whose plain help has one section for each ``rich_help_panel`` of its options.

    Contexts, commands and formatters are Click's, which typer ships under a name that depends on its version: hence
    ``Any`` in this file.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the line; a value of the wrong kind is quoted in the error, unlike in Typer's own.

        Raises:
            InvalidValue: a value is not a number, or outside of its bounds.
        """
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as error:
            failed = getattr(error.__cause__, "errors", list)()  # pydantic's, whose rules Typer applies
            if not failed or error.param is None:
                raise
            should = str(failed[0]["msg"]).partition(",")[0].replace("Input should", "it should")
            raise InvalidValue(error.param.opts[0], repr(failed[0]["input"]), should) from None

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options, group by group, in the order in which the groups first appear."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
                groups.setdefault(getattr(parameter, "rich_help_panel", None) or usual, []).append(record)
        for name, records in groups.items():
            with formatter.section(name):
                formatter.write_dl(records)


class Deferred(TyperCommand):
    """A command known by name and one line, imported when it is needed."""

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


class Group(TyperGroup):
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
        return [*self.members, *(name.removeprefix(prefix) for name in COMMANDS if name.startswith(prefix))]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a group, or a placeholder for a command.

        Raises:
            UnknownName: there is none of this name.
        """
        added = f"{self.name}.{cmd_name}"
        known = COMMANDS[added] if added in COMMANDS else self.members.get(cmd_name)
        if known is None:
            raise UnknownName("command", cmd_name, self.list_commands(ctx))
        if isinstance(known, typer.Typer):
            return command_of(cmd_name, known)
        if known.members:
            return Group(
                name=cmd_name, members=known.members, help=known.about, no_args_is_help=True, rich_markup_mode=None
            )
        return Deferred(cmd_name, known.about, lambda: command_of(cmd_name, Lazy(known.where).load(), known.example))


def command_of(name: str, found: Callable[..., Result | None] | typer.Typer, example: str = "") -> Any:
    """Return the command of a function or of a Typer app, with the options that every command has.

    Args:
        name: of the command.
        found: the function, with its options as parameters, or the app, which prints for itself.
        example: a line that calls it; an app has its own.
    """
    app = found
    if not isinstance(app, typer.Typer):
        app = typer.Typer(rich_markup_mode=None, add_completion=False)
        app.command(name, cls=Command, epilog=f"Example: {example}")(_printing(found))  # type: ignore[arg-type]
    made: Any = get_command(app)
    made.name = name
    if not isinstance(made, TyperGroup):
        made.params.append(quiet_option())
    return made


def _printing(found: Callable[..., Result | None]) -> Callable[..., None]:
    """Return a function that prints what another one returns, with ``--plugin`` and ``--json``.

    A function that takes one of these options itself keeps it; one that returns nothing has no ``--json``.
    """
    signature = inspect.signature(found, eval_str=True)
    shared = {"plugin": Plugins} | ({"as_json": JsonFlag} if signature.return_annotation is Result else {})
    added = [
        inspect.Parameter(
            option, inspect.Parameter.KEYWORD_ONLY, default=None if option == "plugin" else False, annotation=kind
        )
        for option, kind in shared.items()
        if option not in signature.parameters
    ]
    names = {parameter.name for parameter in added}

    def command(**given: Any) -> None:
        result = found(**{option: value for option, value in given.items() if option not in names})
        if result is not None:
            result.show(given.get("as_json", False))

    parameters = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in signature.parameters.values()]
    command.__signature__ = inspect.Signature([*parameters, *added])  # type: ignore[attr-defined]
    command.__annotations__ = {p.name: p.annotation for p in [*parameters, *added]}
    command.__doc__ = found.__doc__
    return command
