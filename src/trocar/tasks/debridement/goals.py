"""Goals of debridement: fragments are interchangeable, so a goal is one more of them."""

from __future__ import annotations

from typing import NamedTuple


class Clearing(NamedTuple):
    """One goal: one more fragment is to rest in the receptacle.

    Attributes:
        number: 0 is the first that is cleared, 1 the second, whichever fragments they are.
    """

    number: int
