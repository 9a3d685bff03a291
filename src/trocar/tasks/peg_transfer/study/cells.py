"""What the study is made of: one ordinary run for each variant and method."""

from __future__ import annotations

from pathlib import Path

from trocar.tasks.kit import methods_of
from trocar.tasks.peg_transfer.task import VARIANTS, PegTransfer
from trocar.trials.cells import Cell, cell_of, chosen
from trocar.trials.config import RunConfig


def cells_of(  # noqa: D417 (the rest as in RunConfig)
    folder: Path, variants: str = "", methods: str = "", *, transfers: int = 12, **run: object
) -> list[Cell]:
    """Return the cells of a study in the order of the tables.

    Args:
        folder: of the study; each cell has one in it.
        variants: with commas; empty: all that the task has.
        methods: likewise.
        transfers: only the first so many.
    """
    cells = []
    for variant in chosen(variants, VARIANTS, "variants"):
        for method in chosen(methods, list(methods_of(PegTransfer)), "methods"):
            task = PegTransfer(variant=variant, transfers=transfers)
            cells.append(cell_of(folder, variant, RunConfig(task=task, method=method, **run)))  # type: ignore[arg-type]
    return cells
