"""Commands and groups of commands, imported when they are called, with the options and the printing that all share.

A command is a function whose typed parameters are its options. It returns a :class:`Result`, which is printed as text
or, with ``--json``, as one JSON object. Other packages add commands by entry points.
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

from trocar.cli.options import JsonFlag, Plugins, Quiet
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
                    console.print(part, highlight=False, soft_wrap=isinstance(part, str))
        if not self.succeeded:
            raise typer.Exit(1)


@dataclass(frozen=True)
class Known:
    """What is known of a command before it is imported.

    Attributes:
        about: one line for the list of commands; for a group, the whole text of its help.
        where: ``module:name`` of its function, or of a :class:`Group`; empty for a group of these ``members``.
        example: a line that calls it.
        members: of a group, by name.
    """

    about: str
    where: str = ""
    example: str = ""
    members: Mapping[str, Known] = field(default_factory=dict)


COMMANDS: Registry[Known] = Registry("command", "trocar.commands")
"""Commands that other packages and tasks add, by ``GROUP.NAME``."""


class Command(TyperCommand):
    """A command whose plain help has one section for each ``rich_help_panel`` of its options.

    Contexts, commands and formatters are Click's. Typer ships Click under a name that depends on Typer's version, hence
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
            failed = getattr(error.__cause__, "errors", list)()  # of pydantic, whose rules Typer applies
            if not failed or error.param is None:
                raise
            should = str(failed[0]["msg"]).partition(",")[0].replace("Input should", "it should")
            raise InvalidValue(error.param.opts[0], repr(failed[0]["input"]), should) from None

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options, section by section, in the order in which these first appear."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
                sections.setdefault(getattr(parameter, "rich_help_panel", None) or usual, []).append(record)
        for name, records in sections.items():
            with formatter.section(name):
                formatter.write_dl(records)


class Deferred(TyperCommand):
    """A command or group known by name and one line; ``load`` imports it when it is needed."""

    def __init__(self, name: str, about: str, load: Callable[[], Any]) -> None:
        super().__init__(name, callback=None, help=about)
        self.load = load

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Return the context of the loaded command, which then parses, completes and runs."""
        return self.load().make_context(info_name, args, parent, **extra)

    def get_short_help_str(self, limit: int = 45) -> str:
        """Return the whole line."""
        del limit
        return self.help or ""


class Group(TyperGroup):
    """A group of known members that also has the commands registered under its name."""

    def __init__(self, name: str, about: str, members: Mapping[str, Known], **rest: Any) -> None:
        super().__init__(name=name, **{"help": about, "no_args_is_help": True, "rich_markup_mode": None, **rest})
        self.members = members

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        del ctx
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

        def load() -> Any:
            found = Lazy(known.where).load() if known.where else Group(cmd_name, known.about, known.members)
            return found if isinstance(found, Group) else command_of(cmd_name, found, known.example)

        return Deferred(cmd_name, known.about, load)


def command_of(name: str, function: Callable[..., Result | None], example: str) -> Any:
    """Return the command of a function, with ``--plugin``, ``--quiet`` and ``--json``; it prints the result.

    A function that takes one of these options itself keeps it; one that returns nothing has no ``--json``.

    Args:
        name: of the command.
        function: its parameters are the options.
        example: a line that calls it.
    """
    signature = inspect.signature(function, eval_str=True)
    shared: dict[str, tuple[Any, Any]] = {"plugin": (Plugins, None)}
    if signature.return_annotation is Result:
        shared["as_json"] = (JsonFlag, False)
    shared["quiet"] = (Quiet, False)
    keyword = inspect.Parameter.KEYWORD_ONLY
    parameters = [parameter.replace(kind=keyword) for parameter in signature.parameters.values()]
    added = [name for name in shared if name not in signature.parameters]
    for option in added:
        kind, default = shared[option]
        parameters.append(inspect.Parameter(option, keyword, default=default, annotation=kind))

    def command(**given: Any) -> None:
        result = function(**{option: value for option, value in given.items() if option not in added})
        if result is not None:
            result.show(given.get("as_json", False))

    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    command.__doc__ = function.__doc__
    app = typer.Typer(rich_markup_mode=None, add_completion=False)
    app.command(name, cls=Command, epilog=f"Example: {example}")(command)
    return get_command(app)
