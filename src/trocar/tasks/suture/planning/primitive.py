"""The needle primitive (paper, Fig. 2 and section IV-A1): poses of needle and jaws, and the arm's joints along it.

In the circle's frame a suture at theta heads along ``h`` (clockwise: minus the tangent); ``n`` is the tissue's normal.
The needle's tip first enters straight along ``t = cos(entry) h - sin(entry) n``, then rotates about the needle's
centre, which lies at the needle's radius along ``u = sin(entry) h + cos(entry) n``. The jaws then move back along the
wire and push it on, as often as the insertion says. A suture at theta is the one at 0 rotated about the circle's axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, ik_unbounded, wrist_depth_m
from trocar.errors import InvalidValue
from trocar.geometry import SE3, SO3, TURN, shown
from trocar.geometry.arrays import finite
from trocar.tasks.suture.planning.clearance import above_tissue_m, arms_apart_m, fingers_above_m, inside_wall_m
from trocar.tasks.suture.planning.setup import DIRECTION_NAMES, DIRECTIONS, SutureSetup

BEFORE_EXIT_RAD, PAST_EXIT_RAD = math.radians(12.0), math.radians(8.0)
"""The arm does not release the needle within these rotations before and after the needle's tip comes out."""
SPACING_M, SPACING_RAD = 0.25e-3, math.radians(1.0)
"""Spacing of the waypoints along a path."""
LIMIT_TOLERANCE = 1e-9
INSERTION, ROLL = 2, 3


@dataclass(frozen=True)
class Step:
    """One movement of the primitive: start and end values of three coordinates.

    Attributes:
        name: penetrate, rotate, regrasp 1, push 1, ...
        advance_m: travel along the straight penetration.
        jaws_rad: rotation of the jaws about the needle's centre.
        needle_rad: rotation of the needle about its centre.
    """

    name: str
    advance_m: tuple[float, float]
    jaws_rad: tuple[float, float]
    needle_rad: tuple[float, float]

    @property
    def back_rad(self) -> float:
        """Return how far back along the wire the jaws hold the needle, relative to the first grip."""
        return self.needle_rad[0] - self.jaws_rad[0]

    @property
    def holds(self) -> bool:
        """Return whether the jaws hold the needle, so that both move together."""
        return not self.name.startswith("regrasp")


def steps(setup: SutureSetup) -> tuple[Step, ...]:
    """Return the movements of the primitive in order."""
    return _steps(setup, _holds_rad(setup))


def driven_steps(setup: SutureSetup) -> tuple[Step, ...]:
    """Return the movements as an arm makes them: it holds the needle while the tip comes out of the tissue.

    If the primitive released the needle between ``BEFORE_EXIT_RAD`` before and ``PAST_EXIT_RAD`` after that point, the
    opening and closing of the jaws would decide where the tip comes out. So the needle is released later, if the jaws
    can go back far enough before that, or else earlier. The jaws stay on the path of :func:`steps`, whose rotation
    starts at 0.

    Later is better: at the exit, the jaws are then where a look at the resting needle has shown how the joints err
    there. In 20 sutures at `recorded`, the tip came out half as far again from the exit if the needle was released 12
    or 22 deg before it.
    """
    insertion, exit_rad = setup.insertion, setup.exit_turn_rad
    ends = _holds_rad(setup)
    for k, end in enumerate(ends[:-1]):
        if exit_rad - BEFORE_EXIT_RAD < end < exit_rad + PAST_EXIT_RAD:
            start = ends[k - 1] if k else 0.0
            later, earlier = exit_rad + PAST_EXIT_RAD, exit_rad - BEFORE_EXIT_RAD
            if later - start <= insertion.rotation_rad and later < ends[k + 1]:
                ends[k] = later
            elif earlier > start and ends[k + 1] - earlier <= insertion.rotation_rad:
                ends[k] = earlier
    return _steps(setup, ends)


def _holds_rad(setup: SutureSetup) -> list[float]:
    """Return the needle's rotation at the end of each grip."""
    insertion = setup.insertion
    return [insertion.rotation_rad + k * insertion.regrasp_rad for k in range(insertion.pushes + 1)]


def _steps(setup: SutureSetup, ends: Sequence[float]) -> tuple[Step, ...]:
    """Return the movements whose successive grips end at these rotations of the needle."""
    straight = setup.insertion.straight_m
    still, top, jaws = (straight, straight), setup.insertion.rotation_rad, ends[0]
    found = [
        Step("penetrate", (0.0, straight), (0.0, 0.0), (0.0, 0.0)),
        Step("rotate", still, (0.0, jaws), (0.0, jaws)),
    ]
    for number, (needle, end) in enumerate(pairwise(ends), 1):
        again = top - (end - needle)
        found.append(Step(f"regrasp {number}", still, (jaws, again), (needle, needle)))
        found.append(Step(f"push {number}", still, (again, top), (needle, end)))
        jaws = top
    return tuple(found)


def needle_poses(setup: SutureSetup, advance_m: ArrayLike, turn_rad: ArrayLike) -> SE3:
    """Return the needle's poses (2, k) in the circle's frame at theta = 0, one row per direction of ``DIRECTIONS``.

    The needle's frame has its origin at the centre of curvature, x along the motion of the tip, y from the tip to the
    centre, and z normal to its plane. The needle travels (k,) along the straight penetration, then turns (k,) about its
    centre.
    """
    advance, turn = np.broadcast_arrays(np.asarray(advance_m, float), np.asarray(turn_rad, float))
    down = setup.insertion.entry_angle_rad
    back = setup.bite_m / 2 if setup.insertion.theta_is == "middle" else 0.0
    rows = []
    for direction in DIRECTIONS:
        heading, normal = np.array([0.0, -direction, 0.0]), np.array([0.0, 0.0, 1.0])
        t = math.cos(down) * heading - math.sin(down) * normal
        u = math.sin(down) * heading + math.cos(down) * normal
        entry = np.array([setup.circle.radius_m, 0.0, 0.0]) - back * heading
        centers = entry + setup.needle.radius_m * u + advance[:, None] * t
        attitude = SO3.unchecked(np.column_stack([t, u, np.cross(t, u)])) @ SO3.axis("z", turn)
        rows.append(SE3.from_parts(attitude, centers).matrix)
    return SE3.unchecked(np.stack(rows))


def grasp_pose(setup: SutureSetup) -> SE3:
    """Return the pose of the arm's tip in the needle's frame, before any regrasp."""
    return setup.grasp.pose(setup.needle.radius_m)


def tip_poses(setup: SutureSetup, advance_m: ArrayLike, jaws_rad: ArrayLike) -> SE3:
    """Return the poses (2, k) of the arm's tip in the circle's frame at theta = 0; arguments as ``needle_poses``."""
    return needle_poses(setup, advance_m, jaws_rad) @ grasp_pose(setup)


def turned_to(T_circle: SE3, thetas_rad: ArrayLike) -> SE3:
    """Return poses (2, k), given at theta = 0, rotated to every theta (n,): (2, n, k)."""
    turn = SE3.from_parts(SO3.axis("z", np.asarray(thetas_rad, float)))
    return SE3.unchecked(turn.matrix[:, None] @ T_circle.matrix[:, None])


@dataclass(frozen=True, eq=False)
class PathSamples:
    """Samples along the path of the jaws, each place once, ordered so that neighbours are close.

    Attributes:
        advance_m: (k,) travel along the straight penetration.
        jaws_rad: (k,) rotation of the jaws about the needle's centre.
        station: (k,) whether a movement starts or ends here; the paper's margin is evaluated at these places.
        opened: (k,) whether the jaws may be open here at some time, as they move back or let go: along the rotation.
    """

    advance_m: NDArray[np.float64]
    jaws_rad: NDArray[np.float64]
    station: NDArray[np.bool_]
    opened: NDArray[np.bool_]


def path_samples(setup: SutureSetup) -> PathSamples:
    """Return samples of the primitive: 3 on the straight path, at least 8 on the rotation."""
    insertion = setup.insertion
    top = insertion.rotation_rad
    again = top - insertion.regrasp_rad if insertion.pushes else top
    turn = np.union1d(np.linspace(min(0.0, again), top, 8), again)
    turn = turn[np.abs(turn) > 1e-12]  # 0 is already there, as the end of the straight path
    advance = np.linspace(0.0, insertion.straight_m, 3)
    return PathSamples(
        np.append(advance, np.full(len(turn), insertion.straight_m)),
        np.append(np.zeros(len(advance)), turn),
        np.append(np.isin(advance, (0.0, insertion.straight_m)), np.isin(turn, (top, again))),
        np.append(np.zeros(len(advance), dtype=bool), np.ones(len(turn), dtype=bool)),
    )


def jaws_above_m(setup: SutureSetup) -> float:
    """Return the least height of the jaws above the tissue's plane along a suture, wherever it is."""
    samples = path_samples(setup)
    T_circle_tip = tip_poses(setup, samples.advance_m, samples.jaws_rad)
    return float(fingers_above_m(setup.arm, T_circle_tip, samples.opened).max(0).min())


@dataclass(frozen=True)
class Suture:
    """One suture: the geometry, its position on the circle, and its direction, one of ``DIRECTIONS``."""

    setup: SutureSetup
    theta_rad: float
    direction: int

    def __post_init__(self) -> None:
        if self.direction not in DIRECTIONS:
            raise InvalidValue("the direction of a suture", repr(self.direction), "give 1 (clockwise) or -1")
        if not math.isfinite(self.theta_rad):
            raise InvalidValue("the position of a suture", f"{self.theta_rad} rad", "give a finite angle")

    def __str__(self) -> str:
        return f"{shown(self.theta_rad, 'rad', '.4g')} {DIRECTION_NAMES[self.direction]}"

    @property
    def row(self) -> int:
        """Return the row of ``DIRECTIONS`` in which it is driven."""
        return DIRECTIONS.index(self.direction)

    def turned(self, T_circle: SE3) -> SE3:
        """Return the primitive's poses (2, k) at theta = 0, moved to this suture's position and direction: (k,)."""
        return turned_to(T_circle, [self.theta_rad])[self.row, 0]

    def needle_tip_m(self, advance_m: NDArray[np.float64], turn_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the needle's tip (k, 3) in the circle's frame; arguments as ``needle_poses``."""
        T_circle_needle = self.turned(needle_poses(self.setup, advance_m, turn_rad))
        return T_circle_needle.apply(self.setup.needle.p_tip_m)

    @property
    def needle_path_m(self) -> NDArray[np.float64]:
        """Return the path (k, 3) of the needle's tip in the circle's frame while the jaws drive the needle."""
        insertion = self.setup.insertion
        advance = np.linspace(0.0, insertion.straight_m, 1 + math.ceil(insertion.straight_m / SPACING_M))
        last = insertion.turn_rad
        turn = np.linspace(0.0, last, 1 + math.ceil(last / SPACING_RAD))[1:]
        return self.needle_tip_m(
            np.append(advance, np.full(len(turn), insertion.straight_m)), np.append(np.zeros(len(advance)), turn)
        )

    @property
    def entry_m(self) -> NDArray[np.float64]:
        """Return the point (3,) where the needle enters the surface, in the circle's frame."""
        return self.needle_tip_m(np.zeros(1), np.zeros(1))[0]

    @property
    def exit_m(self) -> NDArray[np.float64] | None:
        """Return the point (3,) where the needle comes out again, in the circle's frame; None if it never does."""
        insertion, turn = self.setup.insertion, self.setup.exit_turn_rad
        if not turn <= insertion.turn_rad:
            return None
        return self.needle_tip_m(np.array([insertion.straight_m]), np.array([turn]))[0]

    @property
    def ends_m(self) -> NDArray[np.float64]:
        """Return entry and exit (2, 2) in the plane of the circle, or where the tip stops if it never comes out."""
        return self._seen_from_above_m(self._last_turn_rad)

    @property
    def path_ends_m(self) -> NDArray[np.float64]:
        """Return entry and farthest point (2, 2) of the tip's path in the tissue, seen from above."""
        beneath_centre_rad = self.setup.insertion.entry_angle_rad + math.pi / 2
        return self._seen_from_above_m(min(self._last_turn_rad, beneath_centre_rad))

    @property
    def _last_turn_rad(self) -> float:
        return self.setup.exit_turn_rad if self.setup.comes_out else self.setup.insertion.turn_rad

    def _seen_from_above_m(self, turn_rad: float) -> NDArray[np.float64]:
        """Return the entry, and the needle's tip (2, 2) after this rotation."""
        tip = self.needle_tip_m(np.array([self.setup.insertion.straight_m]), np.array([turn_rad]))[0]
        return np.stack([self.entry_m, tip])[:, :2]


def sutures_at(setup: SutureSetup, positions_rad: ArrayLike, directions: ArrayLike) -> tuple[Suture, ...]:
    """Return the sutures at positions (n,) in directions (n,)."""
    both = zip(np.asarray(positions_rad).tolist(), np.asarray(directions).tolist(), strict=True)
    return tuple(Suture(setup, theta, direction) for theta, direction in both)


def least_gap_rad(setup: SutureSetup) -> float:
    """Return the gap of neighbours above which their paths in the tissue, each along its tangent, do not meet."""
    along_m = float(np.abs(Suture(setup, 0.0, DIRECTIONS[0]).path_ends_m[:, 1]).max()) + setup.needle.wire_m
    return 2 * math.atan(along_m / setup.circle.radius_m)


@dataclass(frozen=True, eq=False)
class SutureJoints:
    """Configurations of the arm along sutures.

    Attributes:
        setup: the geometry.
        thetas_rad: (n,) positions on the circle.
        q: (2, n, k, 6) joints, rad and m: one row per direction of ``DIRECTIONS``, at the k samples of
            ``path_samples``; NaN where the arm has no real solution. The roll is continuous, in the winding that stays
            nearest to the middle of its range.
        station: (k,) which samples are stations.
        above_tissue_m: (2, n) least height of fingers, wrist, shaft and port above the tissue's plane.
        inside_wall_m: (2, n) clearance of instrument and needle from the body wall, less the required one; infinite if
            there is no wall.
        arms_apart_m: (2, n) likewise between the two arms' instruments; infinite if there is no second arm, minus
            infinity where it cannot pull the needle through.
    """

    setup: SutureSetup
    thetas_rad: NDArray[np.float64]
    q: NDArray[np.float64]
    station: NDArray[np.bool_]
    above_tissue_m: NDArray[np.float64]
    inside_wall_m: NDArray[np.float64]
    arms_apart_m: NDArray[np.float64]

    @property
    def arm(self) -> ArmModel:
        """Return the arm."""
        return self.setup.arm

    @cached_property
    def excess(self) -> NDArray[np.float64]:
        """Return how far each joint leaves its range at worst (2, n, 6), rad or m; infinite where q is NaN."""
        outside = np.maximum(self.arm.lower - self.q.min(2), self.q.max(2) - self.arm.upper)
        return np.where(np.isfinite(outside), np.maximum(outside, 0.0), np.inf)

    @cached_property
    def too_shallow_m(self) -> NDArray[np.float64]:
        """Return by how much (2, n) the wrist at worst falls short of the safe depth; infinite where q is NaN."""
        short_m = self.arm.safe_depth_m - wrist_depth_m(self.arm, self.q).min(2)
        return np.where(np.isfinite(short_m), np.maximum(short_m, 0.0), np.inf)

    @cached_property
    def drivable(self) -> NDArray[np.bool_]:
        """Return which sutures (2, n) keep joints within limits, the wrist deep, and clear of tissue and body wall."""
        within = (self.excess <= LIMIT_TOLERANCE).all(-1) & (self.too_shallow_m <= LIMIT_TOLERANCE)
        return within & (np.minimum(self.above_tissue_m, self.inside_wall_m) >= -LIMIT_TOLERANCE)

    @cached_property
    def feasible(self) -> NDArray[np.bool_]:
        """Return which sutures (2, n) are drivable and let the second arm, if there is one, come to the needle."""
        return self.drivable & (self.arms_apart_m >= -LIMIT_TOLERANCE)

    @cached_property
    def largest_wrist_rad(self) -> NDArray[np.float64]:
        """Return the paper's q_max (2, n, 3): the largest |angle| of roll, wrist pitch and yaw at the stations."""
        return np.abs(self.q[:, :, self.station, 3:]).max(2)


def suture_joints(setup: SutureSetup, thetas_rad: ArrayLike) -> SutureJoints:
    """Return the joints along the sutures at these positions (n,), in both directions, in closed form.

    Raises:
        InvalidInput: a position is not finite.
    """
    thetas = np.atleast_1d(finite("positions of sutures", thetas_rad, ...))
    samples = path_samples(setup)
    # A suture at theta is the one at 0 rotated about the circle's axis, T_base_circle Rz(theta) T_circle_tip, and Rz is
    # linear in 1, cos and sin: a sum of three terms replaces two matrix products per sample and position.
    parts = np.zeros((3, 4, 4))
    parts[0, 2, 2] = parts[0, 3, 3] = parts[1, 0, 0] = parts[1, 1, 1] = parts[2, 1, 0] = 1.0
    parts[2, 0, 1] = -1.0
    at_zero = tip_poses(setup, samples.advance_m, samples.jaws_rad)
    harmonics = (setup.T_base_circle.matrix @ parts)[:, None, None] @ at_zero.matrix
    turns = np.stack([np.ones_like(thetas), np.cos(thetas), np.sin(thetas)], -1)
    poses = turns @ np.moveaxis(harmonics.reshape(*harmonics.shape[:3], 16), 0, 2).swapaxes(0, 1)
    # samples are the outermost axis in memory: minima and maxima along a suture then run over whole rows, which is fast
    q = np.moveaxis(ik_unbounded(setup.arm, SE3.unchecked(poses.reshape(*poses.shape[:-1], 4, 4))), 0, 2)
    q[..., ROLL] = unwound(q[..., ROLL], setup.arm.middle_floats[ROLL])
    return with_clearances(setup, thetas, q, samples, at_zero)


def with_clearances(
    setup: SutureSetup,
    thetas_rad: NDArray[np.float64],
    q: NDArray[np.float64],
    samples: PathSamples,
    T_circle_tip: SE3,
    rows: slice = slice(None),
) -> SutureJoints:
    """Return the sutures with these joints (2, n, k, 6), and their clearances.

    The tip's poses (2, k) are those of the samples at theta = 0. Joints and poses may be of some ``rows`` alone.
    """
    inside_m = apart_m = np.full(q.shape[:2], np.inf)
    if setup.wall.up_m:
        T_circle_needle = needle_poses(setup, samples.advance_m, 0.0)[rows]
        inside_m = inside_wall_m(setup, thetas_rad, T_circle_tip, T_circle_needle, q)
    if setup.puller.up_m:
        at_end = needle_poses(setup, [setup.insertion.straight_m], [setup.insertion.turn_rad])[rows, 0]
        tip_m = at_end.apply(setup.needle.p_tip_m)
        apart_m = arms_apart_m(setup, thetas_rad, tip_m, q[..., -1, :])
    return SutureJoints(
        setup,
        thetas_rad,
        q,
        samples.station,
        np.minimum(above_tissue_m(setup.arm, T_circle_tip, samples.opened, q[..., 5]), setup.port_above_tissue_m),
        inside_m,
        apart_m,
    )


def unwound(roll: NDArray[np.float64], middle: float = 0.0, of: slice = slice(None)) -> NDArray[np.float64]:
    """Return roll (..., k) rad without jumps along its last axis, in the winding that stays nearest to the middle.

    The inverse kinematics give the roll only up to whole turns; wrapped to one turn, it jumps at some positions.
    The extremes within the slice ``of`` of the last axis decide the winding.
    """
    roll = np.unwrap(roll, axis=-1)
    deciding = roll[..., of]
    center = (deciding.max(-1) + deciding.min(-1)) / 2
    return roll - TURN * np.rint((center - middle) / TURN)[..., None]
