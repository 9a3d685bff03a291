"""Groups of one command per task, with that task's own options: ``trocar run TASK``, ``trocar study TASK``."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Annotated, Any

import typer

from trocar.cli.group import Deferred, Group, Known, command_of
from trocar.cli.options import load_given
from trocar.errors import BadFile, InvalidInput, UnknownName
from trocar.eval import TASKS, Task, methods_of, perceptions_of
from trocar.registry import PLUGIN_MODULE

OWN = "Of this task"
"""Heading of a task's own options."""
CONFIG = "--config"
NO_MEMBERS: Mapping[str, Known] = {}


class TaskGroup(Group):
    """The tasks as commands. A plugin that is named anywhere on the line is loaded before its task is looked up.

    Attributes:
        body: the function that a task's command calls, with the options of every run and those of the task.
        kind: what a member is called where one is unknown.
        about: the description in its help.
        example: a line, with ``{task}`` for the task's name and, if it needs one, its plugin.
    """

    body: Callable[..., None]
    kind: str
    about: str
    example: str
    members = NO_MEMBERS

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the content of ``--config FILE`` before the words of the line, load its plugins, and parse it."""
        args = _expanded(args)
        load_given(args)
        return super().parse_args(ctx, args)

    def tasks(self) -> Sequence[str]:
        """Return the names of the tasks that are commands here."""
        return list(TASKS)

    def listed(self, task: type[Task]) -> str:
        """Return the name of a task's option that takes several values here; empty: none."""
        del task
        return ""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        return [*super().list_commands(ctx), *self.tasks()]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a placeholder for the command of a task; its options are found when they are needed."""
        if cmd_name not in self.tasks():
            if cmd_name not in super().list_commands(ctx):
                raise UnknownName(self.kind, cmd_name, self.list_commands(ctx))
            return super().get_command(ctx, cmd_name)
        task = TASKS[cmd_name]
        return Deferred(cmd_name, f"{_about(task)}.", lambda: task_command(task, type(self), self.listed(task)))


def _expanded(args: Sequence[str]) -> list[str]:
    """Return a line whose ``--config FILE`` is replaced by the file's content, before the words of the line itself."""
    words, first = list(args), []
    while CONFIG in words:
        at = words.index(CONFIG)
        if at + 1 == len(words):
            raise InvalidInput(CONFIG, "names no file", "give a TOML file of options")
        first = _words_of(Path(words[at + 1]))
        del words[at : at + 2]
    return first + words


def _words_of(path: Path) -> list[str]:
    """Return the words of a command line from a TOML file: the task first, then its options by name."""
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise BadFile(path, f"is no readable TOML file ({error})", "see examples/run.toml", kind=CONFIG) from None
    words = [str(values.pop("task"))] if "task" in values else []
    for name, value in values.items():
        flag = f"--{name.replace('_', '-')}"
        for one in value if isinstance(value, list) else [value]:
            if isinstance(one, dict):
                raise BadFile(path, f"has a table {name!r}", "give options by name, one a line", kind=CONFIG)
            words += [flag] if one is True else [] if one is False else [flag, str(one)]
    return words


def task_command(task: type[Task], group: type[TaskGroup], listed: str = "") -> Any:
    """Return the command of one task: the options of the group's ``body``, and the fields of the task.

    Args:
        task: the task.
        group: of the command.
        listed: a field of the task whose option takes several values with commas.
    """
    own = {field.name: field for field in fields(task)}  # type: ignore[arg-type]
    of_body = inspect.signature(group.body, eval_str=True).parameters.values()
    usual = [p for p in of_body if p.name not in ("task", "options")]
    taken = [name for name in own if name in {p.name for p in usual}]
    if taken:
        problem = "is already an option of every run"
        raise InvalidInput(f"option {taken[0]!r} of task {task.name!r}", problem, "give it another name")
    hints = {
        k: v
        for kind in reversed(task.__mro__)
        if kind not in (Task, object)
        for k, v in inspect.get_annotations(kind, eval_str=True).items()
    }
    added = [
        _listed(name, field) if name == listed else _parameter(name, field, hints[name]) for name, field in own.items()
    ]

    def command(**given: Any) -> None:
        options = {name: given.pop(name) for name in own}
        group.body(task=task, options=options, **given)

    parameters = [_described(p, task) for p in usual] + added
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {p.name: p.annotation for p in parameters}
    ways = methods_of(task).items()
    methods = "; ".join(f"{name}: {getattr(method, 'about', 'from elsewhere')}" for name, method in ways)
    command.__doc__ = (
        f"{_about(task)}.\n\n"
        f"{group.about} Interrupted, it keeps its finished trials; the same command continues where it stopped.\n\n"
        f"Methods: {methods}."
    )
    plugin = "--plugin FILE " if task.__module__.startswith(PLUGIN_MODULE) else ""
    return command_of(task.name, command, group.example.format(task=f"{task.name} {plugin}".strip()))


def _about(task: type[Task]) -> str:
    return f"{task.about[:1].upper()}{task.about[1:]}"


def _described(parameter: inspect.Parameter, task: type[Task]) -> inspect.Parameter:
    """Return a parameter of every run with this task's choices in its help."""
    choices: dict[str, Sequence[str]] = {"method": tuple(methods_of(task)), "perception": perceptions_of(task)}
    if parameter.name not in choices:
        return parameter
    kind, option = parameter.annotation.__origin__, parameter.annotation.__metadata__[0]
    known = ", ".join(choices[parameter.name]) or "none here"
    described = typer.Option(
        *option.param_decls or (), help=f"{option.help} ({known}).", show_default=option.show_default
    )
    return parameter.replace(annotation=Annotated[kind, described])


def _parameter(name: str, field: Any, hint: Any) -> inspect.Parameter:
    """Return the command line's parameter of a task's field."""
    about = field.metadata
    default = None if field.default is MISSING else field.default
    flag = f"--{(about.get('flag') or name).replace('_', '-')}"
    choices = about.get("choices", ())
    described = typer.Option(
        flag,
        help=about.get("help", "") + (f" One of {', '.join(choices)}." if choices else ""),
        metavar=about.get("metavar") or None,
        rich_help_panel=OWN,
        show_default=default is not None,
    )
    return _option(name, hint, default, described)


def _listed(name: str, field: Any) -> inspect.Parameter:
    """Return the parameter for several values of a task's field."""
    flag = f"--{name}" if name.endswith("s") else f"--{name}s"
    described = typer.Option(
        flag, metavar="A,B,...", help=field.metadata["help"], rich_help_panel=OWN, show_default="all"
    )
    return _option(name, str, "", described)


def _option(name: str, kind: Any, default: Any, described: Any) -> inspect.Parameter:
    annotation = Annotated[kind, described]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
