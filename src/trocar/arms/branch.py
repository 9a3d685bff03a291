"""The branches of the closed-form inverse kinematics, and the constants of an arm that its solver needs."""

from __future__ import annotations

from typing import NamedTuple


class Branch(NamedTuple):
    """One of the eight solutions of the inverse kinematics, by the signs of cos q6, cos q5 and sin(q2 + offset)."""

    yaw: int
    wrist: int
    pitch: int


BRANCHES = tuple(Branch(u6, u5, u2) for u6 in (1, -1) for u5 in (1, -1) for u2 in (1, -1))
"""All branches, in the order of ``ik_branches``."""


class SolverConstants(NamedTuple):
    """Constants of one branch of one arm; c and s are cosine and sine of the twists 0, 1, 2.

    Attributes:
        branch: the signs.
        wrist_sign: +1 or -1.
        wrist_length_m: pitch axis to yaw axis.
        tip_length_m: yaw axis to tip.
        c0, s0, c1c2, s1s2, s1c2, c1s2: products of these cosines and sines.
        u_s1, u_s2: s1 and s2 times the branch's sign of sin(q2 + offset).
        offsets: six, subtracted from the angles.
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
