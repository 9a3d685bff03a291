"""When an arm may start a motion, given the announced motions of others: distances between moving bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from trocar.arms import SOLIDS, ArmModel, fk
from trocar.arms.solids import solid_radii_m
from trocar.cell import Cell
from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.geometry.capsules import Capsules, capsule_distances_m
from trocar.motion import MovingArm, swept_clearance
from trocar.trajectory import Trajectory

NEVER = (inf, inf)
"""An empty interval of a motion: nothing may be touched at any time."""
STEP_S = 0.04
"""Time between samples of two motions."""
DELAY_STEP_S = 0.08
"""Step between the delays that are tried."""
CLOSER_M = 0.5e-3
"""Arms that are already closer than the margin may come this much closer on their way apart."""
MIN_DISTANCE_M = 1.2e-3
"""They may not come closer than this, unless they already are: the stations' guards keep 1 mm."""
GUARDED_M = 5e-5
"""Arms even closer than ``MIN_DISTANCE_M`` may come this much closer; the guards would allow .1 mm."""
AT_END = 1e-6
"""An arm this close (rad, m) to the end of its motion has arrived."""


@dataclass(frozen=True, eq=False)
class MovingBody:
    """A moving arm, and the solids in its jaws, in the frame of its tip; None: the jaws are empty."""

    arm: MovingArm
    held: Capsules | None = None

    def empty(self) -> MovingBody:
        """Return the body with empty jaws."""
        return replace(self, held=None)

    def capsules(self, t_s: Array) -> Capsules:
        """Return all capsules in the world at the times (n,): ends (n, k, 2, 3) m."""
        ends, radii = self.arm.ends_m(t_s), solid_radii_m(self.arm.model)
        if self.held is None:
            return Capsules(ends, radii)
        held = self.held.moved(self.arm.T_world_base @ fk(self.arm.model, self.arm.joints(t_s)))
        return Capsules(np.concatenate([ends, held.ends_m], axis=1), np.concatenate([radii, held.radii_m]))


def distance_m(a: MovingBody, a_s: float, b: MovingBody, b_s: float) -> float:
    """Return the distance between body ``a`` at time ``a_s`` and body ``b`` at ``b_s``, each on its own clock."""
    return float(capsule_distances_m(a.capsules(np.array([a_s])), b.capsules(np.array([b_s]))).min())


def min_delay_s(
    mover: MovingBody,
    other: MovingBody,
    now_s: float,
    margin_m: float,
    delays_s: Sequence[float],
    contact_s: tuple[float, float] = NEVER,
) -> float | None:
    """Return the first of several delays after which a body may start; None if none of them works.

    Distances are only sampled; the caller must check the chosen motion between the samples.

    Args:
        mover: the body that waits; its motion starts at 0 of its arm's own clock.
        other: the body to avoid; its clock is the cell's.
        now_s: the cell's clock.
        margin_m: distance to keep.
        delays_s: delays to try, in order.
        contact_s: interval of its motion in which the mover may touch what the other one holds.
    """
    lasting_s = mover.arm.trajectory.duration_s
    until_s = max(other.arm.end_s - now_s, 0.0)
    own_s = np.append(np.arange(0.0, lasting_s, STEP_S), lasting_s)
    mine, arm = mover.capsules(own_s), slice(len(SOLIDS))
    for delay_s in delays_s:
        last_s = max(lasting_s + delay_s, until_s)
        times = np.append(np.arange(0.0, last_s, STEP_S), last_s)
        index = np.clip(np.searchsorted(own_s, times - delay_s - 1e-9), 0, len(own_s) - 1)
        theirs = other.capsules(now_s + times)
        apart = (times < delay_s + contact_s[0]) | (times >= delay_s + contact_s[1])
        apart_own, near_own = (Capsules(mine.ends_m[index[when]], mine.radii_m) for when in (apart, ~apart))
        # in the contact interval, only the other arm itself counts, not what it holds
        gaps = capsule_distances_m(apart_own, Capsules(theirs.ends_m[apart], theirs.radii_m))
        touching = capsule_distances_m(near_own, Capsules(theirs.ends_m[~apart, arm], theirs.radii_m[arm]))
        if min(gaps.min(initial=inf), touching.min(initial=inf)) >= margin_m:
            return delay_s
    return None


@dataclass(frozen=True, eq=False)
class Departure:
    """How an arm gets away from the end of a motion.

    Attributes:
        motion: from there to a place out of the way.
        held: what it will hold then, in the frame of its tip; None: nothing.
    """

    motion: Trajectory
    held: Capsules | None = None


@dataclass
class Lane:
    """What one arm does, as announced.

    Attributes:
        model: of the arm.
        T_world_base: its base, as registered, or a better estimate.
        announced: its motion; None at rest.
        held: solids in its jaws, in the frame of its tip; None: empty.
        departure: how it gets away from where that motion ends; None: it need not.
        jaw_rad: widest opening of its jaws on that motion.
    """

    model: ArmModel
    T_world_base: SE3
    announced: Trajectory | None = None
    held: Capsules | None = None
    departure: Departure | None = None
    jaw_rad: float = 0.0


class Traffic:
    """The arms that share a space, and when one of them may start a motion.

    Args:
        cell: the laboratory.
        arms: names.
        min_margin_m: distance kept by arms that depart.

    Attributes:
        lanes: what each arm does.
    """

    def __init__(self, cell: Cell, arms: Sequence[str], min_margin_m: float):
        self._cell, self._min_margin_m = cell, min_margin_m
        self.lanes = {name: Lane(cell.arms[name], cell.T_world_base_registered[name]) for name in arms}

    def delay_s(
        self, arm: str, motion: Trajectory, margin_m: float, contact_s: tuple[float, float], departure: Departure | None
    ) -> float | None:
        """Return the delay after which a motion is free; None if it never is while the other arms rest where they end.

        Args:
            arm: at rest where the motion starts, its lane up to date.
            motion: of its joints.
            margin_m: distance to keep from the other arms; less if they are already closer than that.
            contact_s: interval of the motion in which the jaws may touch what another arm holds.
            departure: how the arm gets away from where the motion ends.
        """
        now, lane = self._cell.clock.now_s(), self.lanes[arm]
        mover = MovingBody(MovingArm(lane.model, motion, lane.T_world_base, 0.0, lane.jaw_rad), lane.held)
        bodies = {name: self._body(name) for name in self.lanes if name != arm}
        delay = 0.0
        for name, body in bodies.items():
            if not self._can_depart(lane, departure, self.lanes[name], body, motion):
                return None
            here = distance_m(mover, 0.0, body if contact_s[0] > 0 else body.empty(), now)
            until = max(0.0, body.arm.end_s - now)
            delays = np.arange(0.0, until + DELAY_STEP_S, DELAY_STEP_S).tolist()
            found = min_delay_s(mover, body, now, _relaxed(margin_m, here), delays, contact_s)
            if found is None:
                return None
            delay = max(delay, found)
        if delay == 0.0 and not self._certain(arm, replace(mover.arm, start_s=now), bodies, margin_m):
            return DELAY_STEP_S if any(self.lanes[name].announced for name in bodies) else None
        return delay

    def _can_depart(
        self, lane: Lane, departure: Departure | None, other: Lane, body: MovingBody, motion: Trajectory
    ) -> bool:
        """Return whether each of two arms could depart from the end of its motion while the other rests at its end."""
        mine = MovingArm.resting(lane.model, motion(motion.times_s[-1]), lane.T_world_base, lane.jaw_rad)
        theirs = MovingArm.resting(other.model, body.arm.joints(body.arm.end_s), other.T_world_base, body.arm.jaw_rad)
        ways = (departure, mine, MovingBody(theirs, body.held)), (other.departure, theirs, MovingBody(mine, lane.held))
        for way, at_end, still in ways:
            if way is None:
                continue
            arm = MovingArm(at_end.model, way.motion, at_end.T_world_base, 0.0, at_end.jaw_rad)
            start = MovingBody(arm, way.held)
            least_m = _relaxed(self._min_margin_m, distance_m(start, 0.0, still, 0.0))
            if min_delay_s(start, still, 0.0, least_m, [0.0]) is None:
                return False
        return True

    def _certain(self, arm: str, mover: MovingArm, bodies: Mapping[str, MovingBody], margin_m: float) -> bool:
        """Return whether the instruments keep the margin between the samples too, if the motion starts now."""
        now_s, movers, others = mover.start_s, {arm: mover}, {name: body.arm for name, body in bodies.items()}
        end = max(mover.end_s, *(other.end_s for other in others.values()))
        here = swept_clearance(movers, others=others, span_s=(now_s, now_s)).sampled_m
        least = _relaxed(margin_m, here)
        return swept_clearance(movers, others=others, span_s=(now_s, end), enough_m=least).distance_m >= least

    def _body(self, arm: str) -> MovingBody:
        """Return an arm as it is now, on the rest of its announced motion or at rest; its clock is the cell's."""
        lane, robot, now = self.lanes[arm], self._cell.robot, self._cell.clock.now_s()
        setpoint, motion = robot.setpoint(arm), lane.announced
        at_end = motion is not None and np.abs(motion(motion.times_s[-1]) - setpoint.q).max() < AT_END
        if motion is None or (at_end and not setpoint.moving):
            jaw_rad = max(0.0, robot.read(arm).jaw_rad)
            resting = MovingArm.resting(lane.model, setpoint.q, lane.T_world_base, jaw_rad)
            return MovingBody(replace(resting, start_s=now - resting.end_s), lane.held)
        begun_s = now - setpoint.path_s if setpoint.moving else now  # admitted, and about to start
        return MovingBody(MovingArm(lane.model, motion, lane.T_world_base, begun_s, lane.jaw_rad), lane.held)


def _relaxed(margin_m: float, here_m: float) -> float:
    """Return the margin, or less if arms are already closer than that, so that they may move apart."""
    return min(margin_m, max(here_m - CLOSER_M, min(MIN_DISTANCE_M, here_m - GUARDED_M)))
