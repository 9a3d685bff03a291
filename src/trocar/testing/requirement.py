"""How a check fails: an assertion error with a sentence, so that pytest counts it as a failed test."""

from __future__ import annotations


class CheckFailed(AssertionError):
    """A part does not do what everything that uses such parts relies on; the sentence says what."""


def require(holds: object, subject: str, requirement: str) -> None:
    """Raise unless a condition holds.

    Args:
        holds: whether it does.
        subject: what is checked: ``task 'dots'``.
        requirement: what it has to do, with the value that it had: ``has one score for each goal, not 2 for 3``.

    Raises:
        CheckFailed: it does not.
    """
    if not holds:
        raise CheckFailed(f"{subject} must: {requirement}")
