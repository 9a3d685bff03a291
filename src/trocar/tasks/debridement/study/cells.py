"""The conditions of the study: one ordinary run for each number of arms and each method."""

from __future__ import annotations

from pathlib import Path

from trocar.eval import methods_of
from trocar.eval.conditions import Cell, cell_of, chosen
from trocar.eval.config import RunConfig
from trocar.tasks.debridement.task import Debridement

ARMS = ("1", "2")


def cells_of(  # noqa: D417 (the rest as in RunConfig)
    folder: Path, arms: str = "", methods: str = "", *, fragments: int = 6, budget_s: float = 1800.0, **run: object
) -> list[Cell]:
    """Return the cells of a study in the order of the tables.

    Args:
        folder: of the study; each cell has one in it.
        arms: how many work, comma-separated; empty: 1 and 2.
        methods: likewise; empty: all that the task has.
        fragments: in each trial.
        budget_s: a trial that takes longer is stopped.
    """
    cells = []
    for count in chosen(arms, ARMS, "arms"):
        for method in chosen(methods, list(methods_of(Debridement)), "methods"):
            task = Debridement(arms=int(count), fragments=fragments, budget_s=budget_s)
            config = RunConfig(task=task, method=method, **run)  # type: ignore[arg-type]
            cells.append(cell_of(folder, task.variant, config))
    return cells
