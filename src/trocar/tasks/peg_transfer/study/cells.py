"""The conditions of the study: one ordinary run for each variant and method."""

from __future__ import annotations

from pathlib import Path

from trocar.eval import methods_of
from trocar.eval.conditions import Cell, cell_of, chosen, compensated_alone
from trocar.eval.config import RunConfig
from trocar.tasks.peg_transfer.task import VARIANTS, PegTransfer


def cells_of(  # noqa: D417 (the rest as in RunConfig)
    folder: Path, variants: str = "", methods: str = "", *, transfers: int = 12, model: str = "", **run: object
) -> list[Cell]:
    """Return the cells of a study in the order of the tables.

    Args:
        folder: of the study; each cell has one in it.
        variants: comma-separated; empty: all that the task has.
        methods: likewise.
        transfers: only the first N.
        model: of the methods that compensate; empty: the default.
    """
    cells = []
    picked = chosen(methods, list(methods_of(PegTransfer)), "methods")
    of_method = compensated_alone(PegTransfer, picked, model=model)
    for variant in chosen(variants, VARIANTS, "variants"):
        for method in picked:
            task = PegTransfer(variant=variant, transfers=transfers)
            config = RunConfig(task=task, method=method, **of_method[method], **run)  # type: ignore[arg-type]
            cells.append(cell_of(folder, variant, config))
    return cells
