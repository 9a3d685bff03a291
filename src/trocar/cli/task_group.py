"""Tasks as commands: the options of a run are the fields of ``RunConfig``, those of a task the task's fields."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Annotated, Any

from typer import Option
from typer.models import OptionInfo

from trocar.cli.group import Deferred, Group, Known, Result, command_of
from trocar.cli.options import FLAG, Plugins, load_given
from trocar.errors import BadFile, InvalidInput, UnknownName
from trocar.eval import TASKS, Task, methods_of, methods_of_any, perceptions_of, pick_method
from trocar.eval.config import RunConfig
from trocar.eval.task import flag_of
from trocar.registry import PLUGIN_MODULE

OWN = "Of this task"
"""Heading of a task's own options."""
CONFIG = "--config"
OF_RUN = {field.name: field for field in fields(RunConfig) if field.metadata}


class TaskGroup(Group):
    """The tasks as commands. A plugin that is named anywhere on the line is loaded before its task is looked up.

    Attributes:
        body: the function that a task's command calls. It gets ``task`` (the class), ``options`` and ``run`` (values of
            the task's and of the run's options); its other parameters are further options of the command.
        kind: what a member is called in the error for an unknown name.
        does: a sentence that says what the commands do.
        example: a line, with ``{task}`` for the task's name and plugin, if any.
        of_run: names of the fields of ``RunConfig`` that are options here.
    """

    body: Callable[..., Result | None]
    kind: str
    does: str
    example: str
    of_run: Sequence[str]

    def __init__(self, name: str, about: str, members: Mapping[str, Known], **rest: Any) -> None:
        def loads_plugins(plugin: Plugins = None) -> None:
            del plugin  # loaded when it was parsed

        shared = command_of(name, loads_plugins, "").params
        super().__init__(name, about, members, params=[one for one in shared if one.name == "plugin"], **rest)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the content of ``--config FILE`` before the words of the line, load its plugins, and parse it."""
        args = _expanded(args, self.members)
        load_given(args)
        return super().parse_args(ctx, args)

    def tasks(self) -> Sequence[str]:
        """Return the names of the tasks that are commands here."""
        return list(TASKS)

    def varied(self, task: type[Task]) -> str:
        """Return the name of a task's option that takes several values here; empty: none."""
        del task
        return ""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        return [*super().list_commands(ctx), *self.tasks()]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a placeholder for the command of a task; its options are found when they are needed."""
        if cmd_name in self.tasks():
            task = TASKS[cmd_name]
            return Deferred(cmd_name, f"{_about(task)}.", lambda: self.command(task))
        if cmd_name not in self.list_commands(ctx):
            file = f"give the task by its name, and its file by --plugin {cmd_name}"
            raise UnknownName(
                self.kind, cmd_name, self.list_commands(ctx), remedy=file if cmd_name.endswith(".py") else ""
            )
        return super().get_command(ctx, cmd_name)

    def command(self, task: type[Task]) -> Any:
        """Return the command of one task: the options of its runs, those of the group's ``body``, and its own."""
        hints = inspect.get_annotations(RunConfig, eval_str=True)
        known = {"method": (*methods_of(task), *methods_of_any()), "perception": perceptions_of(task)}
        parameters = [_parameter(OF_RUN[name], hints[name], choices=known.get(name, ())) for name in self.of_run]
        of_body = inspect.signature(self.body, eval_str=True)
        parameters += [one for one in of_body.parameters.values() if one.name not in ("task", "options", "run")]
        own, varied = {field.name: field for field in fields(task)}, self.varied(task)  # type: ignore[arg-type]
        taken = {one.name for one in parameters} | {flag for one in parameters for flag in _flags(one)}
        for name, field in own.items():
            if taken & {name, flag_of(field)}:
                problem = "is already an option of this command"
                raise InvalidInput(f"option {name!r} of task {task.name!r}", problem, "give it another name")
        classes = (kind for kind in reversed(task.__mro__) if kind not in (Task, object))
        hints = {k: v for kind in classes for k, v in inspect.get_annotations(kind, eval_str=True).items()}
        for name, field in own.items():
            choices = field.metadata.get("choices", ())
            parameters.append(_parameter(field, hints[name], OWN, choices, listed=name == varied))

        def command(**given: Any) -> Result | None:
            options, run = ({name: given.pop(name) for name in names} for names in (own, self.of_run))
            run |= {name: tuple(value or ()) for name, value in run.items() if isinstance(value, list | None)}
            return self.body(task=task, options=options, run=run, **given)

        signature = inspect.Signature(parameters, return_annotation=of_body.return_annotation)
        command.__signature__ = signature  # type: ignore[attr-defined]
        methods = "; ".join(f"{name}: {pick_method(task, name).about}" for name in methods_of(task))
        kept = "Interrupted, it keeps its finished trials; the same command continues where it stopped."
        command.__doc__ = f"{_about(task)}.\n\n{self.does} {kept}\n\nMethods: {methods}."
        plugin = " --plugin FILE" if task.__module__.startswith(PLUGIN_MODULE) else ""
        return command_of(task.name, command, self.example.format(task=f"{task.name}{plugin}"))


def _about(task: type[Task]) -> str:
    return f"{task.about[:1].upper()}{task.about[1:]}"


def _flags(parameter: inspect.Parameter) -> set[str]:
    """Return the flags of a command's parameter."""
    options = (one for one in getattr(parameter.annotation, "__metadata__", ()) if isinstance(one, OptionInfo))
    spelt = {word for option in options for word in option.param_decls or ()}
    return spelt or {f"--{parameter.name.replace('_', '-')}"}


def _parameter(
    field: Field[Any], hint: Any, panel: str = "", choices: Sequence[str] = (), *, listed: bool = False
) -> inspect.Parameter:
    """Return the parameter of a field that ``option`` declares; ``listed``: it takes several values of the field."""
    about, kind = {"help": "", "flag": "", "metavar": "", "shown": "", **field.metadata}, hint
    default = None if field.default is MISSING else field.default
    flag, metavar, shown = flag_of(field), about["metavar"], about["shown"] or default is not None
    help = about["help"] + (f" One of {', '.join(choices)}." if choices else "")
    if hint == tuple[str, ...]:
        kind, default, shown = list[str] | None, None, False
    if listed:
        kind, default, flag = str, "", f"--{field.name.removesuffix('s')}s"
        help, metavar, shown = about["help"], "A,B,...", "all"
    described = Option(flag, help=help, metavar=metavar or None, rich_help_panel=panel or None, show_default=shown)
    annotation = Annotated[kind, described]
    return inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _expanded(args: Sequence[str], members: Container[str]) -> list[str]:
    """Return a line with ``--config FILE`` replaced by the file's content: its options come before the line's own.

    A task on the line counts, not the file's. To one of the ``members``, which are no tasks, the file is passed on.
    """
    words: list[str] = []
    task: list[str] = []
    options: list[str] = []
    rest, path = iter(args), ""
    for word in rest:
        if word == CONFIG or word.startswith(f"{CONFIG}="):
            if path:
                raise InvalidInput(CONFIG, f"names a second file, after {path!r}", "give one")
            path = word[len(CONFIG) + 1 :] or next(rest, "")
            if not path:
                raise InvalidInput(CONFIG, "names no file", "give a TOML file of options")
            task, options = _words_of(Path(path))
        else:
            words.append(word)
    at = 0
    while at < len(words) and words[at].partition("=")[0] == FLAG:  # plugins may come before the task
        at += 1 if "=" in words[at] else 2
    if at < len(words) and not words[at].startswith("-"):
        task, words = words[: at + 1], words[at + 1 :]
        if path and task[-1] in members:
            return [*task, CONFIG, path, *words]
    if options and not task:
        raise BadFile(path, "names no task", 'give one, as task = "peg-transfer", or on the line', kind=CONFIG)
    return [*task, *options, *words]


def _words_of(path: Path) -> tuple[list[str], list[str]]:
    """Return the words of a command line from a TOML file: the task, if it names one, and options by name."""
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise BadFile(path, f"is no readable TOML file ({error})", "see examples/run.toml", kind=CONFIG) from None
    task, words = [str(values.pop("task"))] if "task" in values else [], []
    for name, value in values.items():
        flag = f"--{name.replace('_', '-')}"
        for one in value if isinstance(value, list) else [value]:
            if isinstance(one, dict):
                raise BadFile(path, f"has a table {name!r}", "give options by name, one a line", kind=CONFIG)
            words += [flag] if one is True else [] if one is False else [flag, str(one)]
    return task, words
