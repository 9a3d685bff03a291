"""The conditions of a robustness study: one ordinary run for each method, each flaw and each of its sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trocar.errors import TrocarError
from trocar.eval import Task, methods_of, pick_method
from trocar.eval.conditions import Cell, chosen, compensated_alone
from trocar.eval.config import JOINTS, RunConfig
from trocar.lab.flaws import FLAWS, MILD, MOST_SCALE, SHOWN, Difficulty

USUAL_SCALES = (0.0, 1.0, 2.0, 4.0)


@dataclass(frozen=True, eq=False)
class Condition:
    """One flaw of one size with one method.

    Attributes:
        method: name of the method.
        flaw: its name.
        scale: its size, as a multiple of the recorded one.
        cell: its run; identical conditions share one.
    """

    method: str
    flaw: str
    scale: float
    cell: Cell

    @property
    def size(self) -> float:
        """Return the size in :attr:`unit`."""
        flaw = FLAWS[self.flaw]
        return SHOWN[flaw.unit][1] * flaw.size(self.cell.config.laboratory.difficulty[self.flaw])

    @property
    def unit(self) -> str:
        """Return the unit of the size: 'mm', 'deg', or 'x' for multiples of the recorded size."""
        return SHOWN[FLAWS[self.flaw].unit][0] or "x"


def conditions_of(
    folder: str | Path,
    task: Task,
    *,
    methods: str = "",
    flaws: str = "",
    scales: str = "",
    difficulty: str,
    model: str = "",
    calibration: str = "",
    **run: Any,
) -> list[Condition]:
    """Return the conditions of a study, in the order of its figures.

    Args:
        folder: of the study; each run has one in it.
        task: with its options.
        methods: comma-separated; empty: all that the task has.
        flaws: likewise; empty: all that affect its station.
        scales: sizes of each flaw as multiples of the recorded one, comma-separated; empty: ``USUAL_SCALES``.
        difficulty: of the flaws that are not varied.
        model: of the methods that compensate; empty: the default.
        calibration: of these too; empty: joints with drawn noise.
        run: the rest, as in RunConfig.

    Raises:
        TrocarError: a name is unknown, or a size is not valid.
    """
    folder = Path(folder)
    picked = chosen(methods, list(methods_of(type(task))), "methods")
    of_method = compensated_alone(type(task), picked, model=model, calibration=calibration)
    for method in picked:
        if pick_method(type(task), method).calibrated and not calibration:
            of_method[method] |= {"calibration": JOINTS}
    first = RunConfig(task=task, method=picked[0], difficulty=difficulty, **of_method[picked[0]], **run)
    varied = chosen(flaws, first.laboratory.relevant_flaws(type(task).name), "flaws")
    sizes = _numbers(scales) if scales else list(USUAL_SCALES)
    cells: dict[Path, Cell] = {}
    found = []
    for method in picked:
        for flaw in varied:
            for scale in sizes:
                named = () if _is_usual(flaw, scale, difficulty) else (_text(flaw, scale),)
                own = {**of_method[method], **run}
                config = RunConfig(task=task, method=method, difficulty=difficulty, flaws=named, **own)
                home = (folder / "-".join([method, difficulty, *(f"{flaw}-{scale:g}" for _ in named)])).absolute()
                cell = cells.setdefault(home, Cell(task.variant, method, config, home))
                found.append(Condition(method, flaw, scale, cell))
    return found


def cells_of(conditions: Sequence[Condition]) -> list[Cell]:
    """Return the runs of these conditions, each once."""
    return list({condition.cell.folder: condition.cell for condition in conditions}.values())


def _is_usual(flaw: str, scale: float, difficulty: str) -> bool:
    return difficulty != MILD and Difficulty.of(difficulty).scale(flaw) == scale


def _text(flaw: str, scale: float) -> str:
    """Return a flaw with a multiple of its recorded size, in the form that ``--flaw`` takes."""
    kind = FLAWS[flaw]
    return f"{flaw}={scale * kind.size(kind.values('recorded')):.6g}{kind.unit}"


def _numbers(text: str) -> list[float]:
    try:
        numbers = sorted(float(word) for word in text.split(","))
    except ValueError:
        numbers = []
    if not numbers or not all(0.0 <= number <= MOST_SCALE for number in numbers):
        raise TrocarError(
            f"--scales {text!r} holds no sizes; give numbers from 0 to {MOST_SCALE:g} with commas, times what was "
            "recorded, as in '0,1,2,4'"
        )
    if len(set(numbers)) < len(numbers):
        raise TrocarError(f"--scales {text!r} holds a size twice; give each once")
    return numbers
