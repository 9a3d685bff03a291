"""How a check fails: an assertion error with a sentence, so that pytest counts it as a failed test."""

from __future__ import annotations


class CheckFailed(AssertionError):
    """A part breaks a requirement on which its users rely; the message says which."""


def require(holds: object, subject: str, requirement: str) -> None:
    """Raise unless a condition holds.

    Args:
        holds: whether the condition holds.
        subject: what is checked: ``task 'dots'``.
        requirement: what it must do, with the value found: ``return one score for each goal, not 2 for 3``.

    Raises:
        CheckFailed: the condition does not hold.
    """
    if not holds:
        raise CheckFailed(f"{subject} must: {requirement}")
