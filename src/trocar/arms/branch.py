"""The branches of the closed-form inverse kinematics, and what its solver needs to know of an arm."""

from __future__ import annotations

from typing import NamedTuple


class Branch(NamedTuple):
    """One of eight solutions of the inverse kinematics: signs of cos q6, cos q5, sin t2 (t2 is q2 with its offset)."""

    yaw: int
    wrist: int
    pitch: int


BRANCHES = tuple(Branch(u6, u5, u2) for u6 in (1, -1) for u5 in (1, -1) for u2 in (1, -1))
"""All of them, in the order of ``ik_branches``."""


class SolverConstants(NamedTuple):
    """One branch of one arm in numbers; c and s are cosine and sine of the twists 0, 1, 2.

    Attributes:
        branch: the signs.
        wrist_sign: +1 or -1.
        wrist_length_m: pitch axis to yaw axis.
        tip_length_m: yaw axis to tip.
        c0, s0, c1c2, s1s2, s1c2, c1s2: as they say.
        u_s1, u_s2: with the branch's sign of sin t2.
        offsets: six, to be subtracted from the angles.
    """

    branch: Branch
    wrist_sign: int
    wrist_length_m: float
    tip_length_m: float
    c0: float
    s0: float
    c1c2: float
    s1s2: float
    s1c2: float
    c1s2: float
    u_s1: float
    u_s2: float
    offsets: tuple[float, ...]
