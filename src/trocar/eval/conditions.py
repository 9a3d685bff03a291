"""The conditions of a study, each an ordinary run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from trocar.errors import TrocarError
from trocar.eval.config import RunConfig
from trocar.eval.method import pick_method
from trocar.eval.task import Task


@dataclass(frozen=True, eq=False)
class Cell:
    """One condition of a study.

    Attributes:
        variant: of the task.
        method: how it is done.
        config: of its run.
        folder: of its run, for ``trocar report`` and ``trocar view``.
    """

    variant: str
    method: str
    config: RunConfig
    folder: Path

    @property
    def places(self) -> list[tuple[int, int]]:
        """Return (session, trial) of all trials of the study."""
        return [(s, k) for s in range(self.config.sessions) for k in range(self.config.trials)]


def cell_of(study: str | Path, variant: str, config: RunConfig) -> Cell:
    """Return the cell of a run, whose folder is ``VARIANT-METHOD`` in the study's folder."""
    return Cell(variant, config.method, config, (Path(study) / f"{variant}-{config.method}").absolute())


def chosen(text: str, choices: Sequence[str], flag: str) -> list[str]:
    """Return the words of a comma-separated list; all choices if it is empty.

    Raises:
        TrocarError: a word is not among the choices, is given twice, or is missing between two commas.
    """
    if not text:
        return list(choices)
    words = [word.strip() for word in text.split(",")]
    for word in words:
        if not word:
            raise TrocarError(f"--{flag} {text!r} has a comma too many; choose from {', '.join(choices)}")
        if word not in choices:
            raise TrocarError(f"--{flag} names {word!r}; choose from {', '.join(choices)}")
        if words.count(word) > 1:
            raise TrocarError(f"--{flag} names {word!r} twice; name each once")
    return words


def compensated_alone(task: type[Task], methods: Sequence[str], **given: str) -> dict[str, dict[str, str]]:
    """Return, for each method, the options that only compensating methods have; empty for the others.

    Args:
        task: the task of the methods.
        methods: of a study.
        given: options by name, such as ``model``; empty: not given.

    Raises:
        TrocarError: an option is given, and none of the methods compensates.
    """
    compensate = {method: pick_method(task, method).calibrated for method in methods}
    for name, value in given.items():
        if value and not any(compensate.values()):
            raise TrocarError(
                f"--{name} {value} has no effect with {', '.join(methods)} of {task.name}, which make no calibration; "
                f"drop --{name}"
            )
    return {method: dict(given) if on else dict.fromkeys(given, "") for method, on in compensate.items()}
