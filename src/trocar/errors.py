"""Errors whose cause is outside Trocar: bad input, motions that a robot refuses, trouble with the machine.

Programs decide by an error's type and fields; its message for people is made from them. The command line prints the
message and exits with the error's exit code, so a traceback always means a bug.

    TrocarError
    |-- InvalidInput            what was given cannot be used
    |   |-- InvalidValue        one value is outside of what is allowed
    |   |-- UnknownName         a name is not among the choices
    |   |-- BadFile             a file or folder cannot be used
    |   `-- NotInstalled        an optional dependency is missing
    |-- MotionRefused           a motion that cannot be planned, or that a robot refuses to start or to continue
    |   |-- OutOfReach          a pose or a command outside of a joint's range
    |   |-- OutsideWorkspace    a tip outside of its box
    |   |-- LimitExceeded       a velocity, acceleration or jerk above its limit
    |   |-- TooNear             two bodies closer than allowed
    |   |-- StartMismatch       a motion that does not start where its arm is
    |   |-- ArmMoving           an arm moves that must be at rest
    |   |-- AlreadyThere        start and goal of a motion coincide
    |   |-- StaleReading        an arm's last encoder reading is too old
    |   `-- NoPlan              a planner found nothing, for another reason
    |-- ArmStopped              an arm that did not reach the end of its motion
    |-- EmergencyStop           a person ended the trial
    `-- MachineError            a full disk, a folder without permission, too little memory
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, ClassVar, Self

from trocar.extras import how_to_install


class TrocarError(ValueError):
    """Bad input or a refusal, in one sentence that says what, which value, which bounds or choices, and the remedy."""

    exit_code: ClassVar[int] = 2

    def worded(self, sentence: str) -> Self:
        """Return a copy with another message, from a caller that knows more about the cause."""
        other = copy.copy(self)
        other.args = (sentence,)
        return other

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle needs to recreate the error with its fields."""
        return _recreated, (type(self), self.args, vars(self))


def _recreated(kind: type[TrocarError], args: tuple[Any, ...], fields: dict[str, Any]) -> TrocarError:
    error = kind.__new__(kind, *args)
    error.args = args
    vars(error).update(fields)
    return error


class InvalidInput(TrocarError):
    """What was given cannot be used.

    Attributes:
        item: what was given.
        problem: what is wrong with it, with its value.
        remedy: what to do; empty if the problem says so.
    """

    def __init__(self, item: str, problem: str, remedy: str = ""):
        self.item, self.problem, self.remedy = item, problem, remedy
        super().__init__(_sentence(f"{item} {problem}", remedy))


class InvalidValue(InvalidInput):
    """One ``value`` is outside of what is allowed."""

    def __init__(self, item: str, value: object, remedy: str):
        self.value = value
        super().__init__(item, f"is {value}", remedy)


class UnknownName(InvalidInput):
    """A name is not among the choices; the message lists them and suggests the nearest one.

    Attributes:
        name: the given name.
        choices: the existing names.
    """

    def __init__(self, kind: str, name: str, choices: Iterable[str], *, remedy: str = ""):
        self.name, self.choices = name, tuple(choices)
        meant = get_close_matches(str(name), self.choices, n=1, cutoff=0.65)
        known = f"choose one of {', '.join(self.choices)}" if self.choices else "there are none"
        hint = f"did you mean {meant[0]!r}? " if meant else ""
        super().__init__(f"{kind} {name!r}", "is unknown", f"{hint}{remedy or known}")


class BadFile(InvalidInput):
    """The file or folder ``path`` cannot be used."""

    def __init__(self, path: str | Path, problem: str, remedy: str = "", *, kind: str = ""):
        self.path = Path(path)
        super().__init__(f"{kind} {str(path)!r}".strip(), problem, remedy)


class NotInstalled(InvalidInput):
    """An optional dependency is missing; ``extra`` is the extra of the package that installs it."""

    def __init__(self, item: str, needs: str, extra: str):
        self.extra = extra
        super().__init__(item, f"needs {needs}", how_to_install(extra))


class MotionRefused(TrocarError):
    """A motion cannot be planned, or a robot refuses to start or to continue it.

    Attributes:
        arm: name of the arm or its model; empty if the caller knows it or no single arm is to blame.
    """

    def __init__(self, sentence: str, *, arm: str = ""):
        self.arm = arm
        super().__init__(sentence)


class OutOfReach(MotionRefused):
    """A pose or a command that is outside of a joint's range.

    Attributes:
        joint: name of the joint; empty if no single joint is to blame.
        by: how far outside, rad, or m for a prismatic joint; NaN if unknown.
    """

    def __init__(self, sentence: str, *, arm: str = "", joint: str = "", by: float = float("nan")):
        self.joint, self.by = joint, by
        super().__init__(sentence, arm=arm)


class OutsideWorkspace(MotionRefused):
    """A motion takes a tip out of its workspace box; ``place`` says in words where to."""

    def __init__(self, arm: str, place: str, bounds: str):
        self.place = place
        there = f"takes its tip to {place}, outside {bounds} of its workspace; plan it inside"
        super().__init__(f"the motion of arm {arm!r} {there}", arm=arm)


class LimitExceeded(MotionRefused):
    """A motion exceeds a limit of velocity, acceleration or jerk; ``ratio`` is its value divided by the limit."""

    def __init__(self, sentence: str, *, arm: str = "", ratio: float = float("nan")):
        self.ratio = ratio
        super().__init__(sentence, arm=arm)


class TooNear(MotionRefused):
    """Two bodies come closer than allowed.

    Attributes:
        first: one body, as "psm1 left finger".
        second: the other.
        distance_m: distance between them.
        required_m: required distance.
        at_start: whether they are too near before anything moves.
        arms: the arms that the bodies belong to.
    """

    def __init__(
        self,
        sentence: str,
        *,
        first: str,
        second: str,
        distance_m: float,
        required_m: float,
        arms: Sequence[str] = (),
        at_start: bool = False,
    ):
        self.first, self.second, self.arms = first, second, tuple(arms)
        self.distance_m, self.required_m, self.at_start = distance_m, required_m, at_start
        super().__init__(sentence)


class StartMismatch(MotionRefused):
    """A motion does not start where, or as fast as, its arm is."""

    def __init__(self, arm: str, problem: str, remedy: str):
        super().__init__(_sentence(f"the motion of arm {arm!r} {problem}", remedy), arm=arm)


class ArmMoving(MotionRefused):
    """An arm moves that must be at rest."""

    def __init__(self, arm: str, remedy: str = "await its motion, or replace it"):
        super().__init__(f"arm {arm!r} is already moving; {remedy}", arm=arm)


class AlreadyThere(MotionRefused):
    """Start and goal of a requested motion coincide."""


class StaleReading(MotionRefused):
    """An arm's last encoder reading is too old; ``age_s`` is its age."""

    def __init__(self, arm: str, age_s: float, max_age_s: float):
        self.age_s = age_s
        super().__init__(f"arm {arm!r} has not been read for {age_s:.2f} s, more than {max_age_s:.2f} s", arm=arm)


class NoPlan(MotionRefused):
    """A planner found no motion; ``planner`` is its name, empty if the caller knows it."""

    def __init__(self, reason: str, *, planner: str = ""):
        self.planner = planner
        super().__init__(reason)


class EmergencyStop(TrocarError):
    """A person ended the trial and its run."""


class ArmStopped(TrocarError):
    """The arm named ``arm`` did not reach the end of its motion, and is not used again."""

    def __init__(self, arm: str, reason: str):
        self.arm = arm
        super().__init__(reason)


class MachineError(TrocarError):
    """The machine, not the input, is the problem: a full disk, a folder without permission, too little memory."""

    exit_code = 3


def _sentence(problem: str, remedy: str) -> str:
    return f"{problem}; {remedy}" if remedy else problem
