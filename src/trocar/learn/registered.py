"""The environments by name: ``gymnasium.make("trocar/PegTransfer-v0")``, one for each task there is."""

from __future__ import annotations

import gymnasium

from trocar.eval.task import TASKS


def environment_id(task: str) -> str:
    """Return the name of a task's environment: ``trocar/PegTransfer-v0`` for ``peg-transfer``."""
    return f"trocar/{''.join(word[:1].upper() + word[1:] for word in task.replace('_', '-').split('-'))}-v0"


def register_all() -> None:
    """Register the environment of each task, and from now on of each that is registered."""
    for task in TASKS:
        _register(task)
    if _register not in TASKS.listeners:
        TASKS.listeners.append(_register)


def _register(task: str) -> None:
    name = environment_id(task)
    if name not in gymnasium.registry:
        gymnasium.register(name, entry_point="trocar.learn.environment:CellEnv", kwargs={"task": task})
