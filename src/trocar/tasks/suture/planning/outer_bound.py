"""Best plan while the circle moves within bounds: branch and bound with a proven bound.

If only centre and radius change, the tip at a position theta is shifted by at most the sum of both changes, and not
rotated. With the wrist at depth d beyond the remote centre and the tip's yaw axis at depth r, a shift by s that does
not rotate the tip rotates the shaft by at most s / d, so that on a ball of radius s

    |q3| changes by at most s,    |q5|, |q2| by s / d,    |q6| by s / r,    |q1| by s / (d cos q2),
    |q4| by s (tan |q2| / d + sin |q5| / r)

where each coefficient takes its largest value on the ball (d and r change by at most s). This holds on one branch of
the inverse kinematics, for arms whose yaw, pitch and roll axes meet at right angles. The joints for the central circle
of a box of circles, moved by these amounts towards the middle of their ranges, then bound margin and manipulability in
the box, and the planner, exact on the grid, bounds its plans. Nothing is sampled.
"""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import wrist_depth_m
from trocar.errors import TrocarError
from trocar.geometry import shown
from trocar.tasks.suture.planning.even import plan_even
from trocar.tasks.suture.planning.joints import ROLL, suture_joints
from trocar.tasks.suture.planning.outer import PLACEMENT, free_bounds
from trocar.tasks.suture.planning.parameters import with_parameters
from trocar.tasks.suture.planning.plan import Planner, SuturePlan
from trocar.tasks.suture.planning.rewards import DexterityMap, Reward, dexterity, joint_margin, scored
from trocar.tasks.suture.planning.setup import SutureSetup

FORMULAS = ("smallest", "normalised", "clipped")
"""Margins that decrease as any angle grows, as the bound requires."""

PITCH, YAW = 4, 5
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class CertifiedSearch:
    """The best circle found, and a bound that no circle within the limits exceeds.

    Attributes:
        best: map of the best setup, scaled as at the start.
        plan: the best plan there.
        bound: no feasible plan on this grid has a larger value, for any setup within ``bounds``.
        free: names of the free parameters.
        values: (f,) their values at the best setup.
        bounds: (f, 2) their bounds.
        boxes: number of boxes examined.
        seconds: duration of the search.
    """

    best: DexterityMap
    plan: SuturePlan
    bound: float
    free: tuple[str, ...]
    values: NDArray[np.float64]
    bounds: NDArray[np.float64]
    boxes: int
    seconds: float

    @property
    def certified(self) -> str:
        """Return what is proven, in words."""
        if self.bound == -math.inf:
            return "proven: no circle within the bounds has a feasible plan on this grid"
        return (
            f"inner exact, outer certified: no feasible plan on the grid of {len(self.best.thetas_rad)} positions "
            f"scores more than {self.bound:.4f} for any {', '.join(self.free)} within the bounds; found "
            f"{self.plan.value:.4f}"
        )

    def summary(self) -> dict[str, Any]:
        """Return everything as plain values."""
        return {
            "free": {
                name: {"to": to, "low": low, "high": high}
                for name, to, (low, high) in zip(self.free, self.values.tolist(), self.bounds.tolist(), strict=True)
            },
            "reward": self.plan.reward,
            "feasible": self.plan.feasible,
            "bound": self.bound,
            "boxes": self.boxes,
            "seconds": self.seconds,
            "boxes_per_s": self.boxes / self.seconds,
            "certified": self.certified,
        }


def certified_search(
    setup: SutureSetup,
    reward: Reward | None = None,
    free: Sequence[str] = PLACEMENT,
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    planner: Planner = plan_even,
    positions: int = 360,
    gap: float = 0.01,
    max_boxes: int = 20_000,
    progress: Callable[[int, float], None] | None = None,
) -> CertifiedSearch:
    """Return the best circle to within ``gap``, or as near as ``max_boxes`` allows; the bound tells which.

    Args:
        setup: the initial setup; margin and manipulability are scaled as there.
        reward: how sutures are scored; its margin must decrease as angles grow (``FORMULAS``).
        free: names of the free parameters, from ``PLACEMENT``.
        bounds: of free parameters, in place of ``RANGES``.
        planner: makes the best plan of a map; exact on its grid.
        positions: size of the grid.
        gap: optimality gap at which to stop: bound minus value of the best plan found.
        max_boxes: number of boxes at which to stop.
        progress: called with the number of boxes examined and the current gap.
    """
    start = dexterity(setup, reward, positions)
    limits = free_bounds(free, bounds)
    _check(setup, start.reward, free, limits, gap)
    began = time.perf_counter()

    def bounded(center: NDArray[np.float64], half: NDArray[np.float64]) -> tuple[DexterityMap, float]:
        # the map at the middle of a box, and an upper bound on the plans in it
        there = with_parameters(setup, dict(zip(free, center.tolist(), strict=True)))
        here = scored(there, start.reward, suture_joints(there, start.thetas_rad), scales=start.scales)
        radial = np.array([name == "circle_radius_m" for name in free])
        shift = float(np.linalg.norm(half[~radial]) + half[radial].sum())
        upper = planner(bound_of_ball(here, shift))
        possible = upper.feasible or not start.reward.feasible_first
        return here, upper.value + ROUNDING if possible else -math.inf

    best, plan, at = start, None, limits.mean(1)
    queue: list[tuple[float, int, NDArray[np.float64], NDArray[np.float64]]] = []
    fresh, parent, boxes = [(limits.mean(1), np.diff(limits)[:, 0] / 2)], math.inf, 0
    while True:
        for center, half in fresh:
            here, upper = bounded(center, half)
            boxes += 1
            found = planner(here)
            if plan is None or (found.feasible, found.value) > (plan.feasible, plan.value):
                best, plan, at = here, found, center
            # a part of a box cannot score more than the whole
            heapq.heappush(queue, (-min(upper, parent), boxes, center, half))
        assert plan is not None
        bound = -queue[0][0]
        if progress:
            progress(boxes, bound - plan.value)
        settled = plan.feasible or not start.reward.feasible_first
        if (settled and bound <= plan.value + gap) or boxes >= max_boxes or bound == -math.inf:
            break
        worst, _, center, half = heapq.heappop(queue)
        parent, step = -worst, np.zeros_like(half)
        longest = int(np.argmax(half))
        step[longest] = half[longest] / 2
        fresh = [(center - step, half - step), (center + step, half - step)]
    seconds = time.perf_counter() - began
    return CertifiedSearch(best, plan, bound, tuple(free), at, limits, boxes, seconds)


def bound_of_ball(here: DexterityMap, shift_m: float) -> DexterityMap:
    """Return a map that bounds all maps whose sutures are shifted by up to ``shift_m`` in any direction, not rotated.

    Its sutures are feasible wherever any such suture may be.
    """
    arm, joints, s = here.setup.arm, here.joints, shift_m
    q = joints.q
    depth, bend_cosine = wrist_depth_m(arm, q), np.cos(q[..., PITCH])
    reach, yaw_cosine = np.abs(depth * bend_cosine + arm.wrist_length_m), np.cos(q[..., YAW])
    depth = np.abs(depth)
    bend, lean = np.arccos(np.clip(bend_cosine, -1.0, 1.0)), np.abs(np.arcsin(np.cos(q[..., 1] + arm.offsets[1])))
    # Where pitch or yaw may pass a quarter turn, the arm changes its branch there: nothing is known then but that these
    # angles are large.
    yaw_sure = reach * yaw_cosine > 2 * s
    sure = yaw_sure & (depth * bend_cosine > 2 * s)
    min_depth, min_reach = np.where(sure, depth - s, 1.0), np.where(sure, reach - s, 1.0)
    turn = s / min_depth
    upright = sure & (lean + turn < math.radians(89.0))
    max_lean, max_bend = np.where(upright, lean + turn, 0.0), np.minimum(bend + turn, math.pi / 2)
    roll = s * (np.tan(max_lean) / min_depth + np.sin(max_bend) / min_reach)
    roll = np.broadcast_to(roll.max(2, keepdims=True), roll.shape)
    change = np.stack([turn / np.cos(max_lean), turn, np.full_like(turn, s), roll, turn, s / min_reach], -1)
    change[..., 0][~upright] = math.inf
    change[..., ROLL][~_winding_is_sure(q[..., ROLL] - arm.middle[ROLL], roll, upright)] = math.inf
    change[~sure] = math.inf
    smallest = np.zeros_like(q)
    smallest[..., PITCH] = np.where(yaw_sure, _smallest_angle(depth, bend_cosine, s), 0.0)
    smallest[..., YAW] = _smallest_angle(reach, yaw_cosine, s)
    # The margin only grows as joints come nearer to the middle of their ranges, so all of them move there.
    off = q - arm.middle
    away = np.maximum(np.abs(off) - change, smallest)
    shrunk = replace(joints, q=arm.middle + np.copysign(away, off))
    margin = joint_margin(arm, shrunk, here.reward)
    deep = depth + s + np.where(yaw_sure, 0.0, 2 * arm.wrist_length_m)  # the other branch lies so much deeper
    level, straight = (np.cos(np.where(sure, np.maximum(angle - turn, 0.0), 0.0)) for angle in (lean, bend))
    manipulability = ((level * deep * (deep * straight + arm.wrist_length_m)) ** 2).mean((0, 2))
    (q_offset, q_unit), (m_offset, m_unit) = here.scales
    weight = here.reward.weight
    values = weight * (margin - q_offset) / q_unit + (1.0 - weight) * (manipulability - m_offset) / m_unit
    choice = np.argmax(values - 1e9 * ~shrunk.feasible if here.reward.feasible_first else values, axis=0)
    return replace(here, joints=shrunk, margin=margin, manipulability=manipulability, values=values, choice=choice)


def _smallest_angle(length_m: NDArray[np.float64], cosine: NDArray[np.float64], shift_m: float) -> NDArray[np.float64]:
    """Return the smallest angle with cosine part / length, if part and length each change by up to ``shift_m``."""
    long = length_m > 2 * shift_m
    part, length = length_m * np.abs(cosine) + shift_m, np.where(long, length_m - shift_m, 1.0)
    return np.where(long, np.arccos(np.minimum(part / length, 1.0)), 0.0)


def _winding_is_sure(
    roll: NDArray[np.float64], change: NDArray[np.float64], sure: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return where (2, n) a roll (2, n, k), measured from its middle, keeps its winding all over the ball."""
    steps = np.abs(np.diff(roll, axis=2)).max(2) + 2 * change.max(2)
    off_middle = np.abs(roll.max(2) + roll.min(2)) / 2 + change.max(2)
    return sure.all(2) & (steps < math.pi) & (off_middle < math.pi)


def _check(setup: SutureSetup, reward: Reward, free: Sequence[str], limits: NDArray[np.float64], gap: float) -> None:
    """Raise TrocarError if no bound can be proven."""
    if strange := [name for name in free if name not in PLACEMENT]:
        raise TrocarError(f"no bound is known while {strange[0]} is free; free only {', '.join(PLACEMENT)}")
    if reward.margin not in FORMULAS:
        raise TrocarError(f"no bound is known for the margin {reward.margin!r}; choose {', '.join(FORMULAS)}")
    wrist = (*setup.arm.offsets[PITCH:], *setup.arm.middle[PITCH:])
    if not np.allclose([*np.cos(setup.arm.twists_rad), *wrist], 0.0, atol=1e-12):
        raise TrocarError(f"no bound is known for arm '{setup.arm.name}', whose axes do not meet at right angles")
    if not (math.isfinite(gap) and gap > 0):
        raise TrocarError(f"the gap to the bound is {gap:g}; give a number above 0")
    for name, (low, _) in zip(free, limits, strict=True):
        if name == "circle_radius_m" and low < 2 * setup.needle.radius_m:
            raise TrocarError(
                f"the circle's radius may shrink to {shown(low, 'm')}, too small for a needle of radius "
                f"{shown(setup.needle.radius_m, 'm')}; raise its lower bound to {shown(2 * setup.needle.radius_m, 'm')}"
            )
