"""Teleoperation of one arm: clutched, scaled, and under the same checks as a script's motions."""

from __future__ import annotations

import time

import numpy as np
import trio

from trocar.arms import fk, ik
from trocar.cell import Cell
from trocar.errors import AlreadyThere, OutOfReach
from trocar.geometry import SE3, SO3
from trocar.learn.control import ABSOLUTE, Answer, Control
from trocar.robots import TICK_S
from trocar.robots.retrace import apart, retraced
from trocar.trajectory import Trajectory
from trocar.view.wishes import Held, Step

RATE_HZ = 50.0
"""Set-points per second."""
DWELL_S = 0.2
"""Jaws close at once, but open only after the input has asked for it this long, so that a slip drops nothing."""
SILENT_S = 0.3
"""A device that has not reported for this long counts as released."""
STEP_S = 1.0
"""A key's step that has not arrived after this time on the cell's clock is given up."""
STEP_M_S = 0.02
"""Speed of a key's step. If its goal jumped, each joint would follow as fast as it can, and the tip leave its line."""
AHEAD_M, ARRIVED_M = 1e-3, 1e-6
"""How near the tip is to the end of a key's step when the next one may begin, and when it has arrived."""
UNMOVED = Held(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), turns=False)
CLOSED_RAD = -0.17
"""Target of closing jaws: beyond closed, so that the drive presses."""


class Hand:
    """One arm of a cell, moved by a person.

    While the input is held, the tip follows the input's motion since the clutch was engaged, so engaging or releasing
    the clutch moves nothing; nor does another scale, or an orientation that is locked or unlocked, since the clutch is
    then engaged anew. Where the wrist cannot turn any further, the tip still follows in position.

    Args:
        cell: the cell.
        arm: name.
        jaw_rad: last commanded opening of the jaws; None: the measured one.

    Attributes:
        latencies_s: time from each input to the set-point that follows it, on the machine's clock.
        refused: why the arm does not follow or return, in a sentence; empty if it does. After a key's step, it stays.
        path_q: joints (6,) along the arm's path since it was taken over.
    """

    def __init__(self, cell: Cell, arm: str, jaw_rad: float | None = None):
        self._cell, self.arm = cell, arm
        self._control: Control | None = None
        self._began: tuple[Held, SE3] | None = None
        self._input: tuple[Held, float, str] | None = None  # pose, time, source
        self._new = False
        self._ends_s: float | None = None  # when a key's step is given up, on the cell's clock; None: not a key's
        self._came_m = np.zeros(3)  # how far a key's step has come
        jaw = cell.arms[arm].jaw
        self._closed_rad, self._wide_rad = max(jaw.lower, CLOSED_RAD), jaw.upper
        self._jaw_rad = self._sent_rad = cell.robot.read(arm).jaw_rad if jaw_rad is None else jaw_rad
        self._jaw_since_s = 0.0
        self._jaw_due = self._moves_jaws = False  # whether to send the opening, and whether one was ever sent
        self._answer = Answer()
        self.latencies_s: list[float] = []
        self.refused = ""
        self.path_q = [cell.robot.setpoint(arm).q]

    @property
    def tip(self) -> SE3:
        """Return the commanded pose of the tip in the world, by the registered base."""
        q = self._cell.robot.setpoint(self.arm).q
        return self._cell.T_world_base_registered[self.arm] @ fk(self._cell.arms[self.arm], q)

    @property
    def held(self) -> bool:
        """Return whether the tip follows the input."""
        return self._input is not None

    def hold(self, held: Held | Step, at_s: float, source: str = "") -> None:
        """Note the pose of an input, or a key's step; ignored while another input is held.

        Args:
            held: the pose, or the step. One that comes while more than ``AHEAD_M`` of the step before is still to go is
                dropped: however fast keys come, the tip stops at most so much and a step after the last one.
            at_s: when the input was there, on the machine's monotonic clock.
            source: name of a device, which must report for as long as it is held, and counts as released when it falls
                silent; empty for the page, which reports only changes.
        """
        if self._input is not None and self._input[2] != source:
            return
        if isinstance(held, Step):
            self._add(held, at_s, source)
            return
        if self._began is None:
            self._control = Control(self._cell, (self.arm,), ABSOLUTE, RATE_HZ)
        if self._began is None or (held.scale, held.turns) != (self._began[0].scale, self._began[0].turns):
            self._began = held, self.tip
        self._input, self._new = (held, at_s, source), True

    def release(self, source: str | None = None) -> None:
        """Note that this input (None: any) was released."""
        if self._input is not None and source in (None, self._input[2]):
            self._let_go()
            self.refused = ""

    def _let_go(self) -> None:
        self._began = self._input = self._control = self._ends_s = None
        self._answer = Answer()

    def _add(self, step: Step, at_s: float, source: str) -> None:
        """Hold an input that is a step further than it was, unless the tip is too far behind."""
        if self._input is None:
            self.hold(UNMOVED, at_s, source)
            self._came_m = np.zeros(3)
        assert self._input is not None and self._began is not None  # it is held
        before = self._input[0]
        if self._to_go_m(before) < AHEAD_M - ARRIVED_M:
            self.hold(before._replace(position_m=before.position_m + step.by_m), at_s, source)
            self._ends_s = self._cell.clock.now_s() + STEP_S

    def _to_go_m(self, held: Held) -> float:
        """Return the distance of the tip from where the input has it."""
        assert self._began is not None  # it is held
        return float(np.linalg.norm(self._goal(held, *self._began).translation_m - self.tip.translation_m))

    def _is_over(self) -> bool:
        """Return whether a key's step has arrived or is given up, or a device has fallen silent."""
        if self._input is None:
            return False
        held, at_s, source = self._input
        if self._ends_s is None:
            return source != "" and time.monotonic() - at_s > SILENT_S
        arrived = not self._new and self._to_go_m(held) < ARRIVED_M
        return arrived or self._cell.clock.now_s() > self._ends_s

    def stop(self) -> None:
        """Note that the arm was stopped: release the input, and drop jaw commands that were not sent yet."""
        self.release()
        self._jaw_rad, self._jaw_due = self._sent_rad, False

    def go_on(self) -> None:
        """Note that the arm may move again: the jaws go on to where they were going."""
        self._jaw_due = self._moves_jaws

    def open_jaws(self, share: float, *, anew: bool = False) -> None:
        """Open the jaws to a share of their range; 0: close and press. ``anew``: even if that was sent before."""
        wanted = self._closed_rad if share <= 0 else min(share, 1.0) * self._wide_rad
        if min(wanted, self._jaw_rad) <= self._sent_rad:  # tremor must not restart the dwell
            self._jaw_since_s = self._cell.clock.now_s()
        self._jaw_rad, self._jaw_due = wanted, anew or wanted != self._sent_rad

    def way_back(self) -> Trajectory:
        """Return the motion along the same path back to where the arm was taken over.

        Raises:
            AlreadyThere: the arm is there.
        """
        q = self._cell.robot.setpoint(self.arm).q
        self.path_q.append(q)
        if np.array_equal(q, self.path_q[0]):
            raise AlreadyThere(f"arm {self.arm!r} is where it was taken", arm=self.arm)
        return retraced(np.array(self.path_q))

    def forget_way_back(self) -> None:
        """Drop the part of the path that the arm had retraced when it was stopped on its way back."""
        q = self._cell.robot.setpoint(self.arm).q
        nearest = int(np.argmin([np.abs(before - q).max() for before in self.path_q[:-1]]))
        self.path_q = [*self.path_q[: max(nearest, 1)], q]

    async def follow(self) -> None:
        """Move the arm as the person's input does, until cancelled."""
        async with trio.open_nursery() as nursery:
            while True:
                self._step(nursery)
                await self._cell.clock.sleep(round(1 / RATE_HZ / TICK_S) * TICK_S)

    def _step(self, nursery: trio.Nursery) -> None:
        if self._is_over():
            self._let_go()
        now_s = self._cell.clock.now_s()
        if self._jaw_due and (self._jaw_rad <= self._sent_rad or now_s - self._jaw_since_s >= DWELL_S):
            self._sent_rad, self._jaw_due, self._moves_jaws = self._jaw_rad, False, True
            if not self.held:  # else the next action includes the jaws
                nursery.start_soon(self._cell.robot.jaw, self.arm, self._jaw_rad)
        q = self._cell.robot.setpoint(self.arm).q
        if apart(q, self.path_q[-1]):
            self.path_q.append(q)
        if self._input is None or self._control is None or self._began is None:
            return
        goal, turned_less = self._within_reach(self._goal(self._now_at(self._input[0]), *self._began))
        turn = goal.rotation.as_quaternion()
        self.refused = next(iter(self._answer.refused.values()), turned_less)
        self._answer = Answer()
        self._control.next_step_s()
        action = np.hstack([goal.translation_m, turn[[1, 2, 3, 0]], self._sent_rad])
        action = np.clip(action, self._control.low, self._control.high)
        nursery.start_soon(self._control.act, action, self._answer)
        if self._new:
            self._new = False
            self.latencies_s.append(time.monotonic() - self._input[1])

    def _now_at(self, held: Held) -> Held:
        """Return the pose of the input: of a key's step, as far as it comes at its speed."""
        if self._ends_s is None:
            return held
        left_m = held.position_m - self._came_m
        self._came_m = self._came_m + left_m * min(1.0, STEP_M_S / RATE_HZ / max(float(np.linalg.norm(left_m)), 1e-12))
        return held._replace(position_m=self._came_m)

    def _within_reach(self, goal: SE3) -> tuple[SE3, str]:
        """Return the goal; if it is out of reach, with the tip's present orientation, and why."""
        model, q = self._cell.arms[self.arm], self._cell.robot.setpoint(self.arm).q
        try:
            ik(model, self._cell.T_world_base_registered[self.arm].inverse() @ goal, q)
        except OutOfReach as error:
            return SE3.from_parts(self.tip.rotation, goal.translation_m), f"{error}; the tip turns no further"
        return goal, ""

    @staticmethod
    def _goal(now: Held, then: Held, T_tip: SE3) -> SE3:
        """Return the goal of a tip that was at ``T_tip`` when the clutch was engaged."""
        moved = now.scale * (np.asarray(now.position_m) - then.position_m)
        before, after = (SO3.from_quaternion(np.asarray(held.wxyz)) for held in (then, now))
        turned = after @ before.inverse() if now.turns else SO3.exp(np.zeros(3))
        return SE3.from_parts(turned @ T_tip.rotation, T_tip.translation_m + moved)
