"""The environments by name: after ``import trocar.learn.envs``, ``gymnasium.make("trocar/PegTransfer-v0")``.

Each task has one, including tasks that are registered later.
"""

from __future__ import annotations

from trocar.errors import NotInstalled

try:
    import gymnasium
except ImportError:
    raise NotInstalled("an environment", "gymnasium", "gym") from None

from trocar.eval.task import TASKS


def environment_id(task: str) -> str:
    """Return the name of a task's environment: ``trocar/PegTransfer-v0`` for ``peg-transfer``."""
    return f"trocar/{''.join(word[:1].upper() + word[1:] for word in task.replace('_', '-').split('-'))}-v0"


def _register(task: str) -> None:
    where = "trocar.learn.environment:CellEnv"
    gymnasium.register(environment_id(task), entry_point=where, kwargs={"task": task})


for _task in TASKS:
    _register(_task)
TASKS.listeners.append(_register)
