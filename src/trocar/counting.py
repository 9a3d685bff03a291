"""Counts in words, and the protocol for progress reports."""

from __future__ import annotations

from typing import Protocol


def counted(number: int, thing: str) -> str:
    """Return a number with its noun, whose plural is formed with an s: ``1 trial``, ``2 trials``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


class Tick(Protocol):
    """Reports how far a piece of work has come."""

    def __call__(self, work: str, done: int, total: int | None, now: str = "") -> None:
        """Report progress.

        Args:
            work: name of the work; each name gets its own progress bar.
            done: how much is done.
            total: how much there is; None: unknown.
            now: what is being done at the moment.
        """
        ...


def untold(work: str, done: int, total: int | None, now: str = "") -> None:
    """Report nothing."""
