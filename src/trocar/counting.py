"""Numbers of things in sentences."""

from __future__ import annotations


def counted(number: int, thing: str, things: str = "") -> str:
    """Return a number with its noun: ``1 trial``, ``2 trials``.

    Args:
        number: how many.
        thing: the singular.
        things: the plural, unless it is formed with an s.
    """
    return f"{number} {thing if number == 1 else things or thing + 's'}"
