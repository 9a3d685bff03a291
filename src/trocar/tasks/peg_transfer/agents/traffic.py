"""Who moves when: no arm starts a motion that would bring it too close to what another does or has announced."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
import trio

from trocar.arms import ArmModel
from trocar.cell import Cell, MotionResult, SetPoint
from trocar.geometry import SE3
from trocar.motion import MovingArm, swept_clearance
from trocar.robots.arm_script import ArmScript
from trocar.robots.concurrency import first_of
from trocar.tasks.peg_transfer.agents.moving_body import NEVER, Body, distances_m, min_delay_s
from trocar.tasks.peg_transfer.agents.settings import Settings
from trocar.tasks.peg_transfer.shapes import Block
from trocar.trajectory import Trajectory

DELAY_STEP_S = 0.08
"""Step between the delays that are tried."""
CLOSER_M = 0.5e-3
"""Arms that are closer than the margin may come this much closer on their way apart, ..."""
MIN_DISTANCE_M = 1.2e-3
"""... but not closer than this, unless they already are: the stations' guards keep 1 mm."""
GUARDED_M = 5e-5
"""If arms are even closer than that, the guards let them come .1 mm closer on their way apart."""


AT_END = 1e-6
"""An arm this close (rad, m) to the end of its motion has arrived."""


class Blocked(Exception):
    """A motion cannot start, and waiting does not help."""


@dataclass(frozen=True, eq=False)
class Leaving:
    """How an arm gets away from the end of a motion.

    Attributes:
        motion: from there up until it is clear of the pegs.
        T_tip_block: the block that it will have in its jaws then; None: empty.
    """

    motion: Trajectory
    T_tip_block: SE3 | None


@dataclass
class _Lane:
    """What one arm does, as announced.

    Attributes:
        model: of the arm.
        T_world_base: its base as registered.
        announced: its motion, and the clock at its start; None at rest.
        T_tip_block: the block in its jaws; None: empty.
        leaving: how it gets away from where that motion ends; None: not needed there.
        jaw_rad: widest opening of its jaws on that motion.
        waiting: whether it waits until another arm does something else.
        pressed: set when it is asked to give way.
    """

    model: ArmModel
    T_world_base: SE3
    announced: tuple[Trajectory, float] | None = None
    T_tip_block: SE3 | None = None
    leaving: Leaving | None = None
    jaw_rad: float = 0.0
    waiting: bool = False
    pressed: trio.Event = field(default_factory=trio.Event)


class Traffic:
    """Admits all motions of all scripts: each is checked against what the other arms do, then announced.

    An arm whose motion is not free now waits at rest: as long as the other arm's announced motion requires, or until
    that arm does something else. Of two arms that would wait for each other, one gets ``Blocked``, and its script does
    something else: the one whose jaws are empty, else the one that has waited longer. So does an arm that has waited
    for longer than ``patience_s``.

    Args:
        cell: the laboratory.
        block: shape of what is carried.
        settings: margin, patience, declared time of a check.
    """

    def __init__(self, cell: Cell, block: Block, settings: Settings):
        self._cell, self._block, self._settings = cell, block, settings
        self._lanes: dict[str, _Lane] = {}
        self._changed = trio.Event()

    def join(self, hand: ArmScript) -> None:
        """Add an arm; arms that are not added rest beside the board, and the robot's guard knows them."""
        self._lanes[hand.name] = _Lane(hand.model, self._cell.T_world_base_registered[hand.name])

    @property
    def alone(self) -> bool:
        """Return whether only one arm takes part."""
        return len(self._lanes) == 1

    def carries(self, name: str, T_tip_block: SE3 | None) -> None:
        """Record what an arm holds now; None: nothing."""
        self._lanes[name].T_tip_block = T_tip_block
        self._tell()

    def holds(self, name: str) -> bool:
        """Return whether an arm was recorded as holding a block."""
        return self._lanes[name].T_tip_block is not None

    async def admit(
        self,
        hand: ArmScript,
        trajectory: Trajectory,
        jaw_rad: float | None = None,
        margin_m: float | None = None,
        meets_s: tuple[float, float] = NEVER,
        leaving: Leaving | None = None,
        waits: bool = True,
    ) -> None:
        """Return when a motion is free; it is announced then, and ``run`` has to follow.

        Args:
            hand: the arm, at rest where the motion starts.
            trajectory: of its joints.
            jaw_rad: opening that the jaws reach on the way; None: they stay as they are.
            margin_m: to keep to other arms; None: the default.
            meets_s: interval of the motion in which the jaws may touch the block in the other arm's jaws.
            leaving: how the arm gets away from where the motion ends; the other arm must leave room for that too.
            waits: whether to wait until the other arm does something else, if its announced motion leaves no room.

        Raises:
            Blocked: waiting does not help.
        """
        lane, clock = self._lanes[hand.name], self._cell.clock
        lane.jaw_rad = max(0.0, hand.jaw_rad, jaw_rad or 0.0)
        margin = self._settings.margin_m if margin_m is None else margin_m
        deadline_s = clock.now_s() + self._settings.patience_s
        while (delay := await self._checked(hand.name, trajectory, margin, meets_s, leaving)) != 0.0:
            with self._cell.log.span(hand.name, "waiting"):
                if delay is not None:
                    await clock.sleep(delay)
                elif not waits:
                    raise Blocked
                else:
                    await self._wait_for_change(hand.name, lane, deadline_s)
        lane.announced, lane.leaving = (trajectory, clock.now_s()), leaving
        self._tell()

    async def run(self, hand: ArmScript, trajectory: Trajectory) -> MotionResult:
        """Run a motion that was admitted."""
        try:
            return await hand.move(trajectory)
        finally:
            self._lanes[hand.name].announced = None
            self._tell()

    async def _wait_for_change(self, name: str, lane: _Lane, deadline_s: float) -> None:
        others = [other for key, other in self._lanes.items() if key != name]
        left_s = deadline_s - self._cell.clock.now_s()
        if left_s <= 0:
            raise Blocked
        standing = [other for other in others if other.waiting]
        if standing and lane.T_tip_block is None and any(other.T_tip_block is not None for other in standing):
            raise Blocked
        for other in standing:
            other.pressed.set()
        changed, lane.waiting, lane.pressed = self._changed, True, trio.Event()
        try:
            with trio.move_on_after(left_s):
                await first_of(changed, lane.pressed)
        finally:
            lane.waiting = False
        if lane.pressed.is_set():
            raise Blocked

    def _tell(self) -> None:
        changed, self._changed = self._changed, trio.Event()
        changed.set()

    async def _checked(
        self, name: str, trajectory: Trajectory, margin_m: float, meets_s: tuple[float, float], leaving: Leaving | None
    ) -> float | None:
        """Return the result of ``_free``, timed on the cell's clock and logged; for a single arm nothing is computed.

        The declared time passes before the check, because the check has to see the newest state of the other arms, and
        nothing may come between it and the announcement.
        """
        if self.alone:
            return 0.0
        budget_s = self._settings.traffic_budget_s
        with self._cell.log.span(name, "planning"):
            await self._cell.clock.compute(lambda: None, budget_s)
        begin = time.perf_counter()
        delay = self._free(name, trajectory, margin_m, meets_s, leaving)
        self._cell.log.compute("traffic", time.perf_counter() - begin, budget_s)
        return delay

    def _free(
        self, name: str, trajectory: Trajectory, margin_m: float, meets_s: tuple[float, float], leaving: Leaving | None
    ) -> float | None:
        """Return the delay after which a motion is free; None if it never is while other arms stay where they go."""
        now = self._cell.clock.now_s()
        lane = self._lanes[name]
        moving = MovingArm(lane.model, trajectory, lane.T_world_base, 0.0, lane.jaw_rad)
        mover = Body(moving, lane.T_tip_block, self._block)
        delay = 0.0
        for key, other in self._lanes.items():
            if key == name:
                continue
            body = self._body(key, other)
            if not self._can_leave(lane, leaving, other, body, trajectory):
                return None
            least = _least(mover, body, now, margin_m, meets_s)
            until = max(0.0, body.arm.end_s - now)
            found = min_delay_s(mover, body, now, least, _delays(until), meets_s)
            if found is None:
                return None
            delay = max(delay, found)
        if delay == 0.0 and not self._certain(name, mover, now, margin_m):
            return DELAY_STEP_S if self._anybody_moves(name) else None
        return delay

    def _can_leave(
        self, lane: _Lane, leaving: Leaving | None, other: _Lane, body: Body, trajectory: Trajectory
    ) -> bool:
        """Return whether two arms could get away from where their motions end, one while the other rests there."""
        least = self._settings.min_margin_m
        mine = MovingArm.resting(lane.model, trajectory(trajectory.times_s[-1]), lane.T_world_base, lane.jaw_rad)
        theirs = MovingArm.resting(other.model, body.arm.joints(body.arm.end_s), other.T_world_base, body.arm.jaw_rad)
        ways = [
            (leaving, lane, Body(theirs, body.T_tip_block, self._block)),
            (other.leaving, other, Body(mine, lane.T_tip_block, self._block)),
        ]
        for way, mover, still in ways:
            if way is None:
                continue
            arm = MovingArm(mover.model, way.motion, mover.T_world_base, 0.0, lane.jaw_rad)
            start = Body(arm, way.T_tip_block, self._block)
            here = float(distances_m(start, np.zeros(1), still, np.zeros(1))[0])
            if min_delay_s(start, still, 0.0, _relaxed(least, here), [0.0]) is None:
                return False
        return True

    def _certain(self, name: str, mover: Body, now_s: float, margin_m: float) -> bool:
        """Return whether the instruments keep the margin between the samples too."""
        shifted = MovingArm(mover.arm.model, mover.arm.trajectory, mover.arm.T_world_base, now_s, mover.arm.jaw_rad)
        others = {key: self._body(key, other).arm for key, other in self._lanes.items() if key != name}
        end = max(shifted.end_s, *(other.end_s for other in others.values()))
        here = swept_clearance({name: shifted}, others=others, span_s=(now_s, now_s)).sampled_m
        least = _relaxed(margin_m, here)
        return swept_clearance({name: shifted}, others=others, span_s=(now_s, end), enough_m=least).distance_m >= least

    def _anybody_moves(self, name: str) -> bool:
        return any(lane.announced for key, lane in self._lanes.items() if key != name)

    def _body(self, name: str, lane: _Lane) -> Body:
        """Return an arm as it is now, on the rest of its announced motion or at rest; its clock is the cell's."""
        robot, now = self._cell.robot, self._cell.clock.now_s()
        told = robot.setpoint(name)
        if lane.announced is None or _ended(lane.announced[0], told):
            hold = Trajectory(np.array([0.0, 1e-3]), told.q[None, None])
            arm = MovingArm(lane.model, hold, lane.T_world_base, now - 1e-3, max(0.0, robot.read(name).jaw_rad))
        else:
            begun = now - told.path_s if told.moving else now  # admitted, and about to start
            arm = MovingArm(lane.model, lane.announced[0], lane.T_world_base, begun, lane.jaw_rad)
        return Body(arm, lane.T_tip_block, self._block)


def _least(mover: Body, other: Body, now_s: float, margin_m: float, meets_s: tuple[float, float]) -> float:
    """Return the margin, or the present distance if that is less, since arms that are close may move apart."""
    here = distances_m(mover, np.zeros(1), other if meets_s[0] > 0 else other.empty(), np.array([now_s]))
    return _relaxed(margin_m, float(here[0]))


def _relaxed(margin_m: float, here_m: float) -> float:
    return min(margin_m, max(here_m - CLOSER_M, min(MIN_DISTANCE_M, here_m - GUARDED_M)))


def _ended(motion: Trajectory, told: SetPoint) -> bool:
    """Return whether an arm rests at the end of its motion."""
    return not told.moving and bool(np.abs(motion(motion.times_s[-1]) - told.q).max() < AT_END)


def _delays(until_s: float) -> list[float]:
    return np.arange(0.0, until_s + DELAY_STEP_S, DELAY_STEP_S).tolist()
