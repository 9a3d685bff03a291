"""What a study is made of: one ordinary run for each of its conditions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from trocar.errors import TrocarError
from trocar.trials.config import RunConfig


@dataclass(frozen=True, eq=False)
class Cell:
    """One condition of a study.

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


def cell_of(study: str | Path, variant: str, config: RunConfig) -> Cell:
    """Return the cell of a run, whose folder is ``VARIANT-METHOD`` in the study's."""
    return Cell(variant, config.method, config, (Path(study) / f"{variant}-{config.method}").absolute())


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
