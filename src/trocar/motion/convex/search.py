"""The search over convex programs: which initial paths to try, and how long to pursue each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from trocar.errors import NoPlan
from trocar.geometry.arrays import Array
from trocar.motion.clearance import clearance_of
from trocar.motion.convex.path_program import (
    PathProgram,
    Rows,
    distance_rows,
    faces,
    facing_rows,
    in_range,
    range_rows,
    taper,
)
from trocar.motion.convex.retime import Timing, retimed
from trocar.motion.convex.scene import Scene, columns_of, joint_path
from trocar.motion.curve import Curve
from trocar.motion.problem import JOINTS, ArmMotion, MotionProblem
from trocar.trajectory import Trajectory

Way = tuple[float, float, float]  # offsets of the first two joints (rad), and how far the instrument is pulled back (m)

# Detours that are tried first, and next.
FEW: tuple[Way, ...] = ((0, 0, 0.03), (0, 0, 0.06), (0.2, 0, 0), (-0.2, 0, 0), (0, 0.2, 0), (0, -0.2, 0))
MORE = tuple((a, b, c) for c in (0.0, 0.04, 0.08) for a in (-0.4, 0.0, 0.4) for b in (-0.4, 0.0, 0.4) if a or b or c)
PIECES, PIECES_A_WAYPOINT = 9, 4  # pieces of the curve, and additional ones for each waypoint on the way
SAMPLES_A_PIECE = 4  # places at which a path is planned; it is certified between them too
COARSE = 2  # when starts are compared, only one in this many of these places is used
FINER = 4  # facing is checked in the end at this many times the places used for planning
MARGIN_M, MARGIN_RAD = 5e-4, 0.01  # initial extra margin of distances and angles, for what lies between the places
WATCHED_M = 0.015  # a pair gets a row if it is closer than the required distance plus this
NEAR_M = 0.04  # a pair is tracked if it is closer than the required distance plus this on a start
CERTIFIED_M = 1e-6  # a certified distance may fall short of the required one by this: a tenth of what the check allows
# A path whose distance falls short by this much, though not at the planned places, passes through something.
THROUGH_M = 3e-3
PRICE = 300.0  # penalty per metre of a violated distance, relative to the energy
TRUST_RAD, TRUST_M = 0.35, 0.05  # greatest change of a control point in one step, revolute joints and prismatic one
ACCEPTED = 0.1  # a step is accepted if it achieves this share of the predicted decrease
KEPT_M = 2e-5  # how far a path may violate its margins and still be submitted to certification
WAITS = (0.0, 0.25, 0.5, 0.75, 1.0)  # shares of the time until all other arms rest, by which a motion may start later
# A path with more than FAR_ROUND times the plain path's energy is shortened in at most SHORTER steps, as long as a step
# can reduce its energy to less than the share SAVED.
FAR_ROUND, SAVED, SHORTER = 1.3, 0.97, 10
STARTS = 12  # number of starts pursued from one batch


@dataclass(frozen=True)
class Effort:
    """How long a start is pursued: penalties per violated metre, one after the other, and programs at each."""

    prices: tuple[float, ...]
    steps: int


QUICK, PATIENT = Effort((PRICE,), 6), Effort((PRICE, 10 * PRICE, 100 * PRICE), 8)


@dataclass(frozen=True, eq=False)
class Starts:
    """The starts for one problem: initial paths, from which the search proceeds."""

    arms: tuple[ArmMotion, ...]  # in order
    program: PathProgram  # of the curve and what is held fixed
    plain: Array  # (controls, joints) the path of least energy through all waypoints
    slack: float  # share of the joints' ranges by which they may be left

    def few(self) -> Array:
        """Return the most promising detours (k, controls, joints)."""
        found = []
        for way in FEW[:2]:
            if len(self.arms) > 1:
                found.append(self._aside(dict.fromkeys(range(len(self.arms)), way)))
            found += [self._aside({k: way}) for k in range(len(self.arms))]
        for k, way in product(range(len(self.arms)), FEW[2:]):
            found.append(self._aside({k: way}))
        for first in range(len(self.arms) if len(self.arms) > 1 else 0):
            found.append(self._one_after_the_other(first, {}))
            for k in range(len(self.arms)):
                found.append(self._one_after_the_other(first, {k: FEW[0]}))
        return self._kept(found)

    def many(self) -> Iterator[Array]:
        """Yield batches (k, controls, joints) of all other detours."""
        found = [self._aside({k: way}) for k, way in product(range(len(self.arms)), MORE)]
        yield self._kept(found)
        if len(self.arms) > 1:
            for first in range(len(self.arms)):
                found = [self._one_after_the_other(first, {k: w}) for k, w in product(range(len(self.arms)), MORE)]
                yield self._kept(found)
            pairs = product(MORE[::3], MORE[1::3])
            yield self._kept([self._aside({0: a, 1: b}) for a, b in pairs])

    def _aside(self, ways: dict[int, Way]) -> Array:
        """Return the plain path with some arms (by index) swung aside in the middle."""
        control = self.plain.copy()
        bump = np.sin(np.pi * self.program.curve.places) ** 0.7
        for k, (first, second, back_m) in ways.items():
            control[:, JOINTS * k] += first * bump
            control[:, JOINTS * k + 1] += second * bump
            control[:, JOINTS * k + 2] += self.arms[k].model.wrist_sign * back_m * bump
        return control

    def _one_after_the_other(self, first: int, ways: dict[int, Way]) -> Array:
        """Return paths on which one arm goes first and the others follow, perhaps swung aside."""
        control, curve = self._aside(ways), self.program.curve
        for k in range(len(self.arms)):
            columns = columns_of(k)
            shares = np.clip(2 * curve.places - (k != first), 0.0, 1.0)
            control[:, columns] = curve.basis(shares) @ control[:, columns]
        return control

    def _kept(self, found: list[Array]) -> Array:
        """Return the paths changed to lie within the ranges and pass through the waypoints."""
        controls = np.stack(found)
        for k, arm in enumerate(self.arms):
            columns, spare = columns_of(k), self.slack * (arm.model.upper - arm.model.lower)
            part = np.clip(controls[..., columns], arm.model.lower - spare, arm.model.upper + spare)
            part[:, [0, -1]] = self.plain[[0, -1], columns]
            held = self.program.held[k]
            if len(held):
                across = self.program.curve.spread @ held.T
                off = held @ (self.plain[:, columns] - part)
                part = part + across @ np.linalg.solve(held @ across, off)
            controls[..., columns] = part
        return controls


def plain_path(arms: tuple[ArmMotion, ...], curve: Curve, held: tuple[Array, ...]) -> Array:
    """Return the control points (controls, joints) of the path of least energy through the waypoints of all arms."""
    parts = []
    for arm, basis in zip(arms, held, strict=True):
        line = curve.line(arm.waypoints[0], arm.waypoints[-1])
        if len(basis):
            across = curve.spread @ basis.T
            line = line + across @ np.linalg.solve(basis @ across, arm.waypoints[1:-1] - basis @ line)
        parts.append(line)
    return np.concatenate(parts, axis=1)


@dataclass(frozen=True, eq=False)
class Sight:
    """A path as a program sees it: control points (controls, joints), rows linearised about them, and energy."""

    control: Array
    rows: Rows
    energy: float

    @property
    def broken_m(self) -> float:
        """Return the sum of the violations of the rows."""
        return float(np.maximum(0, -self.rows.room).sum())

    @property
    def worst_m(self) -> float:
        """Return the largest violation of a row."""
        return float(max(0.0, -self.rows.room.min(initial=0.0)))

    def merit(self, price: float) -> float:
        """Return the energy plus the penalty of the violations."""
        return self.energy + price * self.broken_m


class Search:
    """The search for one problem; the pairs it considers and its resolution grow as certificates fail."""

    def __init__(self, problem: MotionProblem, scene: Scene) -> None:
        self.problem, self.scene = problem, scene
        arms = self.arms = scene.arms
        most = max(len(arm.waypoints) for arm in arms)
        self.curve = Curve.even(PIECES + PIECES_A_WAYPOINT * (most - 2))
        self.passing = tuple(passing_shares(arm) for arm in arms)
        held = tuple(self.curve.basis(shares[1:-1]) for shares in self.passing)
        weights = np.concatenate([(arm.limits.acceleration[0] / arm.limits.acceleration) ** 2 for arm in arms])
        self.program = PathProgram(self.curve, weights, held)
        self.starts = Starts(arms, self.program, plain_path(arms, self.curve, held), problem.range_slack)
        self.margin_m, self.margin_rad = MARGIN_M, MARGIN_RAD
        self.passes_through = False
        self._plan_at(self.curve.inner(SAMPLES_A_PIECE))
        self.trust = np.tile([TRUST_RAD, TRUST_RAD, TRUST_M, TRUST_RAD, TRUST_RAD, TRUST_RAD], len(arms))

    def _plan_at(self, shares: Array) -> None:
        self.shares, self.basis = shares, self.curve.basis(shares)

    def plain(self) -> Timing | None:
        """Return the motion along the path of least energy, if it is certified."""
        return self.certified(self._plain_path())

    def round_about(self) -> Timing | None:
        """Return the motion of the first path that is certified; None if none was found."""
        for batch, effort in self._batches():
            for control in self._in_order(batch):
                try:
                    timing = self.followed(control, effort)
                except NoPlan:  # the solver gave up on a program
                    continue
                if timing is not None:
                    return timing
        return None

    def _batches(self) -> Iterator[tuple[Array, Effort]]:
        """Yield starts (k, controls, joints), the most promising first, and how long to pursue them."""
        plain = self.starts.plain[None]
        yield plain, QUICK
        few = self.starts.few()
        yield few, QUICK
        yield plain, PATIENT
        for batch in self.starts.many():
            yield batch, QUICK
        yield few, PATIENT
        for batch in self.starts.many():
            yield batch, PATIENT

    def _plain_path(self) -> Trajectory:
        """Return the path of least energy: a straight line if there are no waypoints on the way."""
        if any(len(shares) > 2 for shares in self.passing):
            return self.curve.path(self.starts.plain)
        start, end = self.starts.plain[0], self.starts.plain[-1]
        return Trajectory(np.array([0.0, 1.0]), np.stack([end - start, start])[:, None])

    def _in_order(self, controls: Array) -> Array:
        """Return the best starts (k, controls, joints) of a batch, best first; track only pairs near in any."""
        self.scene = self.scene.everything()
        shares, basis = self.shares[::COARSE], self.basis[::COARSE]
        q = np.einsum("nc,kcj->knj", basis, controls)
        flat = q.reshape(-1, q.shape[-1])
        distances = self.scene.distances(flat, self._times_s(controls[0], np.tile(shares, len(controls))))
        near = distances.distance_m.reshape(len(controls), len(shares), -1)
        self.scene = self.scene.looking_at(near.min(axis=(0, 1)) < self.problem.min_distance_m + NEAR_M)
        wanted = self.problem.min_distance_m + taper(shares, self.margin_m)
        broken = np.maximum(0.0, wanted[:, None] - near).sum(axis=(1, 2)) * COARSE
        merits = [self.program.energy(c) + PRICE * b for c, b in zip(controls, broken, strict=True)]
        return controls[np.argsort(merits)[:STARTS]]

    def followed(self, control: Array, effort: Effort = PATIENT) -> Timing | None:
        """Return the certified motion that a start leads to; None if it leads to none."""
        sight, self.passes_through = self.seen(control), False
        for price in effort.prices:
            damping = 0.0
            for _ in range(effort.steps):
                if sight.worst_m <= KEPT_M:
                    timing = self.certified(self.curve.path(sight.control))
                    if timing is not None:
                        return self._shortened(sight, timing, price)
                    if self.passes_through:
                        return None
                    sight = self.seen(sight.control)  # the requirements have been tightened
                after, hoped = self._step(sight, price, damping)
                gained, merit = sight.merit(price) - after.merit(price), sight.merit(price)
                if hoped <= 1e-6 * merit:
                    break
                if gained >= ACCEPTED * hoped:
                    sight = after
                    damping *= 0.3 if gained > 0.5 * hoped else 1.0
                else:
                    damping = max(4 * damping, 1.0)
        return None

    def _step(self, sight: Sight, price: float, damping: float) -> tuple[Sight, float]:
        """Return the path after one program, and the decrease of the merit predicted by its linear model."""
        change = self.program.step(sight.control, sight.rows, price, damping)
        change = change * min(1.0, 1.0 / max(1e-9, float((np.abs(change) / self.trust).max())))
        after = self.seen(sight.control + change)
        promised = sight.rows.after(change)
        model = after.energy + price * float(np.maximum(0, -promised).sum())
        return after, sight.merit(price) - model

    def _shortened(self, sight: Sight, timing: Timing, price: float) -> Timing:
        """Return a motion along a path of less energy, if a start made a long detour and steps can shorten it."""
        least, damping, shortest = self.program.energy(self.starts.plain), 0.0, sight.energy
        for _ in range(SHORTER):
            if sight.energy <= FAR_ROUND * least:
                break
            after, hoped = self._step(sight, price, damping)
            if hoped <= (1 - SAVED) * sight.energy:
                break
            if sight.merit(price) - after.merit(price) < ACCEPTED * hoped:
                damping = max(4 * damping, 1.0)
                continue
            sight, damping = after, 0.3 * damping
            if sight.worst_m <= KEPT_M and sight.energy < SAVED * shortest:
                shorter = self.certified(self.curve.path(sight.control))
                if shorter is not None:
                    timing, shortest = shorter, sight.energy
        return timing

    def seen(self, control: Array) -> Sight:
        """Return a path with its constraints and its energy."""
        basis = self.basis
        q = basis @ control
        rows = [range_rows(self.arms, control, self.problem.range_slack)]
        wanted = self.problem.min_distance_m + taper(self.shares, self.margin_m)
        distances = self.scene.distances(q, self._times_s(control, self.shares))
        rows.append(distance_rows(distances, wanted, basis, WATCHED_M))
        rows.append(facing_rows(distances, taper(self.shares, self.margin_rad), basis))
        return Sight(control, Rows.joined(rows), self.program.energy(control))

    def _times_s(self, control: Array, shares: Array) -> Array:
        """Return the times of a path's places, which matter only if another arm moves."""
        if not self.scene.timed:
            return np.zeros(len(shares))
        return self._timed(self.curve.path(control)).times_s(shares)

    def _timed(self, path: Trajectory) -> Timing:
        return retimed(path, self.arms, np.concatenate(self.passing))

    def certified(self, path: Trajectory) -> Timing | None:
        """Return the motion along a path if it meets all requirements, also between places; else tighten them."""
        self.passes_through = False
        fine = path(np.linspace(0.0, 1.0, FINER * SAMPLES_A_PIECE * self.curve.pieces + 1))
        if not in_range(self.arms, fine, self.problem.range_slack):
            return None
        if not faces(self.arms, fine):
            self.margin_rad = min(2 * self.margin_rad, 0.1)
            return None
        if not self.scene.timed:
            return self._timed(path) if self._clear(path, None) else None
        rest_s, timing = max(arm.end_s for arm in self.problem.others.values()), self._timed(path)
        waiting = (timing.later(share * rest_s) for share in WAITS)
        return next((later for later in waiting if self._clear(later.motion, later)), None)

    def _clear(self, motion: Trajectory, timing: Timing | None) -> bool:
        """Return whether all distances are kept on a path (on its motion, if others move); else refine the search."""
        motions = [joint_path(motion, k) for k in range(len(self.arms))]
        too_near_m = self.problem.min_distance_m - THROUGH_M
        clear = clearance_of(self.problem, motions, CERTIFIED_M, too_near_m)
        if clear.distance_m >= self.problem.min_distance_m - CERTIFIED_M:
            return True
        missing_m = self.problem.min_distance_m - clear.sampled_m
        self.passes_through = missing_m > THROUGH_M
        if not self.passes_through:
            self._look_closer(timing, clear.time_s, missing_m)
        return False

    def _look_closer(self, timing: Timing | None, time_s: float, missing_m: float) -> None:
        """Plan with more margin, and with a place where the path was refused."""
        share = time_s if timing is None else float(np.interp(time_s, timing.motion.times_s, timing.shares))
        self.margin_m = min(self.margin_m + 0.5 * missing_m, 2e-3)
        self._plan_at(np.union1d(self.shares, [np.clip(share, 1e-3, 1 - 1e-3)]))
        self.scene = self.scene.everything()


def passing_shares(arm: ArmMotion) -> Array:
    """Return the shares (waypoints,) of the path at which an arm passes its waypoints, by the time its joints need."""
    pieces = (np.abs(np.diff(arm.waypoints, axis=0)) / arm.limits.acceleration).max(axis=1) ** 0.5
    return np.concatenate([[0.0], np.cumsum(pieces) / pieces.sum()])
