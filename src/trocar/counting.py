"""Numbers of things in sentences."""

from __future__ import annotations


def counted(number: int, thing: str, things: str = "") -> str:
    """Return how many of a thing there are: ``1 trial``, ``2 trials``.

    Args:
        number: how many.
        thing: the word for one.
        things: the word for several, where it does not just take an s.
    """
    return f"{number} {thing if number == 1 else things or thing + 's'}"
