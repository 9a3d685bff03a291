"""Autonomous surgical sub-tasks on cable-driven robots: see, calibrate, plan, act, score."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trocar.eval.trials import Trials

__version__ = version("trocar")


def run(task: str, **options: Any) -> Trials:
    """Run trials of a task in the simulated cell and return them (see :func:`trocar.eval.jobs.run`).

    ``trocar.run("peg-transfer", method="best", sessions=3, seed=1, difficulty="mild")``
    """
    return import_module("trocar.eval.jobs").run(task, **options)  # imported here, so that importing trocar stays light
