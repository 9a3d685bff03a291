"""What a study is made of: one ordinary run for each variant and method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from trocar.errors import TrocarError
from trocar.tasks.kit import methods_of
from trocar.tasks.peg_transfer.task import VARIANTS, PegTransfer
from trocar.trials.config import RunConfig
from trocar.trials.folder import open_folder
from trocar.trials.orders import SessionOrder, TrialOrder


@dataclass(frozen=True, eq=False)
class Cell:
    """One condition of the study.

    Attributes:
        variant: of the task.
        method: how it is done.
        config: of its run.
        folder: of its run; ``trocar report`` and ``trocar view`` take it.
    """

    variant: str
    method: str
    config: RunConfig
    folder: Path

    @property
    def places(self) -> list[tuple[int, int]]:
        """Return (session, trial) of all that the study asks for."""
        return [(s, k) for s in range(self.config.sessions) for k in range(self.config.trials)]


def chosen(text: str, choices: Sequence[str], flag: str) -> list[str]:
    """Return the words of a list with commas, all choices if it is empty.

    Raises:
        TrocarError: a word is none of the choices.
    """
    words = list(dict.fromkeys(word.strip() for word in text.split(",") if word.strip())) or list(choices)
    for word in words:
        if word not in choices:
            raise TrocarError(f"--{flag} names {word!r}; choose from {', '.join(choices)}")
    return words


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
            config = RunConfig(task=task, method=method, **run)  # type: ignore[arg-type]
            cells.append(Cell(variant, method, config, (folder / f"{variant}-{method}").absolute()))
    return cells


def opened(cells: Sequence[Cell]) -> tuple[list[SessionOrder], list[TrialOrder]]:
    """Make or take up the folders of all cells; return the sessions to calibrate and the trials to run, in order.

    Trials come session by session, so that an interrupted study has whole sessions of all cells.
    """
    runs = {cell.folder: (cell.config, cell.folder) for cell in cells}
    todo = [TrialOrder(cell.config, cell.folder, *place) for cell in cells for place in open_folder(*runs[cell.folder])]
    todo.sort(key=lambda order: order.session)
    missing: dict[int, dict[Path, tuple[RunConfig, Path]]] = {}
    for order in todo:
        missing.setdefault(order.session, {})[order.folder] = runs[order.folder]
    return [SessionOrder(tuple(found.values()), session) for session, found in missing.items()], todo
