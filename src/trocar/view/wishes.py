"""What a person can ask of a cell at its console, by the page or by a device."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

KEYS = "keys"
"""The source of steps that keys make."""


class Level(Enum):
    """What a script needs confirmation for."""

    AUTONOMOUS = "nothing"
    GOALS = "each goal"
    MOTIONS = "each motion"


class Wish(Enum):
    """What a person can ask for."""

    YES = "the motion that is asked about may start, or this goal is next"
    NO = "the motion that is asked about must not start"
    ANOTHER = "another goal than the one that is asked about"
    STOP = "all arms brake, and stay"
    GO_ON = "arms that were stopped go on"
    EMERGENCY = "all arms brake, and the trial ends"
    TAKE = "the person takes an arm"
    RETURN = "the person returns an arm to the script"
    HOLD = "the handle of an arm is held, and is at a pose"
    RELEASE = "the handle of an arm is let go"
    JAW = "the jaws of an arm open to this share of their range"
    LEVEL = "a script needs a yes for this"
    SPEED = "the clock runs at this speed"
    PAUSE = "pause the clock, or let it run again: whether it is paused"
    STEP = "the clock advances by this time"
    BEGIN = "a trial with this method begins"
    DONE = "the person has done what there is to do"
    LEFT = "the page that held the controls is gone, or does not answer any more"


ANSWERS = (Wish.YES, Wish.NO, Wish.ANOTHER)
"""Wishes that answer a question."""
OF_ANYBODY = (Wish.STOP, Wish.EMERGENCY)
"""Wishes that need no controls: whoever sees a danger stops the arms."""


class Held(NamedTuple):
    """Pose of an input that a person holds.

    Attributes:
        position_m: (3,) along the world's axes.
        wxyz: (4,) orientation.
        scale: metres of the tip per metre of the input; below 1, tremor is scaled down too.
        turns: whether the tip turns with the input; else its orientation is locked.
    """

    position_m: NDArray[np.float64]
    wxyz: NDArray[np.float64]
    scale: float = 1.0
    turns: bool = True


class Step(NamedTuple):
    """A key that was pressed, or pressed again by being held down.

    Attributes:
        by_m: (3,) displacement along the world's axes.
    """

    by_m: NDArray[np.float64]


@dataclass(frozen=True)
class Said:
    """One wish.

    Attributes:
        wish: which.
        arm: the arm that it concerns, if any.
        value: its value, if it has one.
        at_s: when it was made, on the machine's monotonic clock.
        source: name of the device, which must report for as long as it holds an arm; ``KEYS`` for steps by keys; empty
            for all else on the page.
    """

    wish: Wish
    arm: str = ""
    value: Any = None
    at_s: float = field(default_factory=time.monotonic)
    source: str = ""
