"""An arm in a person's hand: clutched, scaled, and moved through the same checks as any script's."""

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
from trocar.view.console_view import Held

RATE_HZ = 50.0
"""Set-points a second."""
DWELL_S = 0.2
"""Jaws close at once, and open only once that was wanted for so long: what is held is not lost by a slip."""
SILENT_S = 0.3
"""An input that must speak, and has not for so long, is not held any more."""
CLOSED_RAD = -0.17
"""Target of jaws that close, which lets the drive press: the scripts' own (peg transfer, sutures)."""


class Hand:
    """One arm of a cell, moved by a person.

    While the input is held, the tip moves as the input does, from where both were when it was clutched: neither
    holding it nor letting it go moves anything. Where the wrist cannot turn any further, the tip still follows in
    place.

    Args:
        cell: the cell.
        arm: name.
        jaw_rad: to which opening the jaws were driven last; None: as they are.

    Attributes:
        latencies_s: from each input to the set-point that follows it, on the machine's clock.
        refused: why the arm does not follow, or come back, in a sentence; empty: it does.
        path_q: the joints where the arm was, since it was taken.
    """

    def __init__(self, cell: Cell, arm: str, jaw_rad: float | None = None):
        self._cell, self.arm = cell, arm
        self._control: Control | None = None
        self._began: tuple[Held, SE3] | None = None
        self._input: tuple[Held, float, str] | None = None  # where it is, when it said so, who
        self._new = False
        jaw = cell.arms[arm].jaw
        self._closed_rad, self._wide_rad = max(jaw.lower, CLOSED_RAD), jaw.upper
        self._jaw_rad = self._sent_rad = cell.robot.read(arm).jaw_rad if jaw_rad is None else jaw_rad
        self._jaw_since_s = 0.0
        self._answer = Answer()
        self.latencies_s: list[float] = []
        self.refused = ""
        self.path_q = [cell.robot.setpoint(arm).q]

    @property
    def tip(self) -> SE3:
        """Return where the tip is commanded now, in the world, by the registered base."""
        q = self._cell.robot.setpoint(self.arm).q
        return self._cell.T_world_base_registered[self.arm] @ fk(self._cell.arms[self.arm], q)

    @property
    def held(self) -> bool:
        """Return whether the tip follows the input."""
        return self._input is not None

    def hold(self, held: Held, at_s: float, source: str = "") -> None:
        """Note where the input is; while one is held, others are not heard.

        Args:
            held: where.
            at_s: when it was there, on the machine's monotonic clock.
            source: whose it is: a device must tell so for as long as it is held, and its silence means that it was let
                go; the page, which has no name, tells its changes alone.
        """
        if self._input is not None and self._input[2] != source:
            return
        if self._began is None:
            self._began = held, self.tip
            self._control = Control(self._cell, (self.arm,), ABSOLUTE, RATE_HZ)
        self._input, self._new = (held, at_s, source), True

    def release(self, source: str | None = None) -> None:
        """Note that this input, or any, was let go."""
        if self._input is not None and source in (None, self._input[2]):
            self._began = self._input = self._control = None

    def stop(self) -> None:
        """Note that the arm was stopped: the input is let go, and jaws that were to open stay as they are."""
        self.release()
        self._jaw_rad = self._sent_rad

    def open_jaws(self, share: float) -> None:
        """Have the jaws open to a share of their range; 0: they close and press."""
        wanted = self._closed_rad if share <= 0 else min(share, 1.0) * self._wide_rad
        if min(wanted, self._jaw_rad) <= self._sent_rad:  # else they were to open already: an input may tremble
            self._jaw_since_s = self._cell.clock.now_s()
        self._jaw_rad = wanted

    def way_back(self) -> Trajectory:
        """Return the motion back to where the arm was when it was taken, along the way that it came.

        Raises:
            AlreadyThere: it is there.
        """
        q = self._cell.robot.setpoint(self.arm).q
        self.path_q.append(q)
        if np.array_equal(q, self.path_q[0]):
            raise AlreadyThere(f"arm {self.arm!r} is where it was taken", arm=self.arm)
        return retraced(np.array(self.path_q))

    def forget_way_back(self) -> None:
        """Note that the arm was stopped on its way back: what it has gone back of its path is not gone again."""
        q = self._cell.robot.setpoint(self.arm).q
        nearest = int(np.argmin([np.abs(before - q).max() for before in self.path_q[:-1]]))
        self.path_q = [*self.path_q[: max(nearest, 1)], q]

    async def follow(self) -> None:
        """Move the arm as the person wants, until this is cancelled."""
        async with trio.open_nursery() as nursery:
            while True:
                self._step(nursery)
                await self._cell.clock.sleep(round(1 / RATE_HZ / TICK_S) * TICK_S)

    def _step(self, nursery: trio.Nursery) -> None:
        if self._input is not None and self._input[2] and time.monotonic() - self._input[1] > SILENT_S:
            self.release()
        now_s = self._cell.clock.now_s()
        if self._jaw_rad != self._sent_rad and (self._jaw_rad < self._sent_rad or now_s - self._jaw_since_s >= DWELL_S):
            self._sent_rad = self._jaw_rad
            if not self.held:  # else the next action says so
                nursery.start_soon(self._cell.robot.jaw, self.arm, self._jaw_rad)
        q = self._cell.robot.setpoint(self.arm).q
        if apart(q, self.path_q[-1]):
            self.path_q.append(q)
        if self._input is None or self._control is None or self._began is None:
            return
        goal, turned_less = self._within_reach(self._goal(self._input[0], *self._began))
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

    def _within_reach(self, goal: SE3) -> tuple[SE3, str]:
        """Return a goal that turns no further than now if the arm cannot reach it as it is, and then why."""
        model, q = self._cell.arms[self.arm], self._cell.robot.setpoint(self.arm).q
        try:
            ik(model, self._cell.T_world_base_registered[self.arm].inverse() @ goal, q)
        except OutOfReach as error:
            return SE3.from_parts(self.tip.rotation, goal.translation_m), f"{error}; the tip turns no further"
        return goal, ""

    @staticmethod
    def _goal(now: Held, then: Held, T_tip: SE3) -> SE3:
        """Return where the tip should be, which was at ``T_tip`` when the input was clutched."""
        moved = now.scale * (np.asarray(now.position_m) - then.position_m)
        before, after = (SO3.from_quaternion(np.asarray(held.wxyz)) for held in (then, now))
        turned = after @ before.inverse() if now.turns else SO3.exp(np.zeros(3))
        return SE3.from_parts(turned @ T_tip.rotation, T_tip.translation_m + moved)
