"""``trocar run TASK``: one command per task, with that task's own options."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import MISSING, fields
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from trocar.cli.group import Deferred, command_of
from trocar.cli.options import load_given
from trocar.errors import TrocarError
from trocar.eval import TASKS, Task, check_task, methods_of, perceptions_of
from trocar.registry import PLUGIN_MODULE

OWN = "Of this task"
"""Heading of a task's own options."""


class TaskGroup(TyperGroup):
    """The tasks as commands. A plugin that is named anywhere on the line is loaded before its task is looked up.

    Attributes:
        body: the function that a task's command calls, with the options of every run and those of the task.
        told: the description in its help.
        example: a line, with ``{task}`` for the task's name and, if it needs one, its plugin.
    """

    body: Callable[..., None]
    told: str
    example: str

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Load the plugins of the line, then parse it as usual."""
        load_given(args)
        return super().parse_args(ctx, args)

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the tasks."""
        del ctx
        return list(TASKS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a placeholder for the command of a task; its options are found when they are needed."""
        del ctx
        task, own = TASKS.pick(cmd_name), type(self)
        check_task(task)
        return Deferred(cmd_name, f"{_about(task)}.", lambda: task_command(task, own.body, own.told, own.example))


def task_command(task: type[Task], body: Callable[..., None], told: str, example: str) -> Any:
    """Return the command of one task: the options of ``body``, and the fields of the task.

    Args:
        task: the task.
        body: called with ``task``, its options as ``options``, and its own parameters by name.
        told: the description in the help.
        example: a line that calls it.
    """
    check_task(task)
    own = {field.name: field for field in fields(task)}  # type: ignore[arg-type]
    usual = [p for p in inspect.signature(body, eval_str=True).parameters.values() if p.name not in ("task", "options")]
    taken = [name for name in own if name in {p.name for p in usual}]
    if taken:
        raise TrocarError(
            f"option {taken[0]!r} of task {task.name!r} is already an option of every run; give it another name"
        )
    hints = {
        k: v
        for kind in reversed(task.__mro__)
        if kind not in (Task, object)
        for k, v in inspect.get_annotations(kind, eval_str=True).items()
    }
    added = [_parameter(name, field, hints[name]) for name, field in own.items()]

    def command(**given: Any) -> None:
        options = {name: given.pop(name) for name in own}
        body(task=task, options=options, **given)

    parameters = [_described(p, task) for p in usual] + added
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {p.name: p.annotation for p in parameters}
    ways = methods_of(task).items()
    methods = "; ".join(f"{name}: {getattr(method, 'about', 'from elsewhere')}" for name, method in ways)
    command.__doc__ = (
        f"{_about(task)}.\n\n"
        f"{told} An interrupted run keeps its finished trials; the same command continues where it stopped.\n\n"
        f"Methods: {methods}."
    )
    plugin = "--plugin FILE " if task.__module__.startswith(PLUGIN_MODULE) else ""
    return command_of(task.name, command, example.format(task=f"{task.name} {plugin}".strip()))


def _about(task: type[Task]) -> str:
    return f"{task.about[:1].upper()}{task.about[1:]}"


def _described(parameter: inspect.Parameter, task: type[Task]) -> inspect.Parameter:
    """Return a parameter of every run with this task's choices in its help."""
    choices: dict[str, Sequence[str]] = {"method": tuple(methods_of(task)), "perception": perceptions_of(task)}
    if parameter.name not in choices:
        return parameter
    kind, option = parameter.annotation.__origin__, parameter.annotation.__metadata__[0]
    known = ", ".join(choices[parameter.name]) or "none here"
    told = typer.Option(*option.param_decls or (), help=f"{option.help} ({known}).", show_default=option.show_default)
    return parameter.replace(annotation=Annotated[kind, told])


def _parameter(name: str, field: Any, hint: Any) -> inspect.Parameter:
    """Return the command line's parameter of a task's field."""
    about = field.metadata
    default = None if field.default is MISSING else field.default
    flag = f"--{(about.get('flag') or name).replace('_', '-')}"
    choices = about.get("choices", ())
    told = typer.Option(
        flag,
        help=about.get("help", "") + (f" One of {', '.join(choices)}." if choices else ""),
        metavar=about.get("metavar") or None,
        rich_help_panel=OWN,
        show_default=default is not None,
    )
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[hint, told])
