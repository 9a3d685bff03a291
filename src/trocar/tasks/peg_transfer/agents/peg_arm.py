"""Actions of one arm with blocks, for the scripts of all agents: grasp, carry, place, let go, retreat."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from functools import partial

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.cell import Result
from trocar.errors import ArmStopped, MotionRefused
from trocar.eval import AgentContext
from trocar.geometry import SE3
from trocar.motion import TimedPath
from trocar.perception.instrument import sight
from trocar.robots import TICK_S
from trocar.robots.concurrency import together
from trocar.robots.coordinator import Blocked, Coordinator
from trocar.robots.driver import JAW_REST_S
from trocar.robots.traffic import NEVER, Departure
from trocar.tasks.peg_transfer.agents.hand import PegHand
from trocar.tasks.peg_transfer.agents.motions import AT_HEIGHT_M, Approach, Carriage, Motions, starts_at
from trocar.tasks.peg_transfer.agents.table import Eyes, Table
from trocar.tasks.peg_transfer.grasps import Grasp
from trocar.trajectory import Trajectory

LETS_GO_RAD = 0.14
"""Additional opening, as read by the encoder, that releases a wall. Of 95 blocks, 13 went up again with the arm, all in
jaws that had truly opened by less than 0.07 rad more. Cables absorb 0.03 rad."""
MOST_RELEASE_RAD = 0.46
"""Widest opening to release a block that was taken from the other arm, whose jaws left little choice of walls. On 16 of
357 such blocks the jaws truly opened by less than 0.085 rad more; three of these went up again with the arm."""
BESIDE_M = 0.035
"""Blocks on pegs this close to a target are considered when a place is chosen there."""
PAUSE_S = 0.3
"""Pause of an arm that cannot leave, before it tries again."""
AT_HOME = 1e-6
OVER_PEGS_M = 2e-3
"""Height over the pegs' tops at which the tip stops for a look before it goes down; changes of the cables' errors below
it are not seen."""
FLOOR_M = 0.7e-3
"""In such a look, points less than this above the pegs do not belong to the instrument."""


class PegArm:
    """One arm, the table that it shares, and the coordinator that admits its motions.

    Attributes:
        hand: moves and computes.
        table: board and blocks.
        coordinator: admits all motions.
        motions: plans its motions.
        home: (6,) joints at which the arm is out of the camera's view.
        goals: all transfers of the trial, of this arm and of others.
        hands_over: whether it grasps blocks so that another arm can take them.
        eyes: look at blocks for it.
        before_descent: called with a grasp and the jaws' opening before the arm goes down to it; None: nothing is done.
        after_release: called when it has released a block; None: nothing is done.
        bound_for: (6,) joints at the end of its present or last motion.
        stopped: whether it failed to reach the end of a motion, and is not used again.
    """

    def __init__(self, context: AgentContext, name: str, table: Table, coordinator: Coordinator):
        self.cell, self.settings, self.goals = context.cell, context.settings, context.goals
        self.table, self.coordinator = table, coordinator
        self.hand = PegHand(
            context.cell,
            name,
            context.settings.settle_s,
            jaw_play_rad=context.settings.jaw_play_rad,
            waits=context.settings.waits_for_jaws,
        )
        self.motions = Motions(context, self.hand, table)
        self.name, self.model, self.home = name, self.hand.model, self.hand.q
        self.bound_for, self.stopped = self.home, False
        self.hands_over = context.nominal.variant == "handover"
        self.eyes = Eyes(self)
        self.before_descent: Callable[[Grasp, float], Awaitable[None]] | None = None
        self.after_release: Callable[[], None] | None = None

    @property
    def T_board_tip(self) -> SE3:
        """Return the pose of the tip according to the joints."""
        return self.motions.tip(self.hand.q)

    @property
    def height_m(self) -> float:
        """Return the height of the tip over the plate."""
        return float(self.T_board_tip.translation_m[2])

    @property
    def holds(self) -> bool:
        """Return whether the jaws' motor stalled on something as thick as a block's wall."""
        return self.table.wall.fits(self.hand.jaw_rad)

    def learn_offset(self, off_m: NDArray[np.float64]) -> None:
        """Learn the tip's offset from a block in the jaws, seen off its place by ``off_m`` (2,) in the board's axes."""
        across = self.T_board_tip.matrix[:2, 0]
        self.motions.offset.learn(across / np.linalg.norm(across), off_m)
        self._moved_by_offset()

    def _moved_by_offset(self) -> None:
        self.coordinator.stands(self.name, self.motions.T_world_base)
        self.cell.log.event("offset", arm=self.name, mm=np.round(1e3 * self.motions.offset.xy_m, 2).tolist())

    @property
    def T_base_floor(self) -> SE3:
        """Return the pose of a plane, z up, above which a look over the pegs shows only instruments."""
        height_m = self.table.board.peg_height_m + FLOOR_M
        return self.motions.T_base_board @ SE3.from_parts(translation_m=[0.0, 0.0, height_m])

    async def stop_over(self, grasp: Grasp, opening_rad: float) -> bool:
        """Stop for a look just over the pegs, before the tip goes down to a grasp; return whether that was possible."""
        height_m = self.table.board.peg_height_m + OVER_PEGS_M
        path = await self.plan(lambda: self.motions.hovering(self.hand.q, grasp.T_board_tip, height_m))
        with suppress(Blocked):  # the other arm may be there
            if path is not None:
                await self.move(path.trajectory, jaw_rad=opening_rad)
                await self.hand.settle()
                return True
        return False

    async def look_at_tip(self, grasp: Grasp) -> None:
        """Look at the jaws over a block that they missed; learn the tip's offset if they are seen."""
        if not await self.stop_over(grasp, self.opening_rad(grasp)):
            return
        image, q, T_base_board = await self.table.capture(self.hand), self.hand.q, self.motions.T_base_board
        T_base_camera = T_base_board @ self.table.T_camera_board.inverse()
        find = partial(sight, image, T_base_camera, self.model, q, self.hand.jaw_rad, self.T_base_floor)
        seen = await self.hand.compute("perception", self.settings.sighting_budget_s, find)
        if seen is None:
            self.cell.log.event("wrist not seen", arm=self.name)
            return
        off_m = fk(self.model, seen.q).translation_m + seen.shift_m - fk(self.model, q).translation_m
        for axis in np.eye(2):
            self.motions.offset.learn(axis, T_base_board.rotation.inverse().apply(off_m)[:2])
        self._moved_by_offset()

    async def exercise_wrist(self) -> None:
        """Turn the wrist back and forth, see ``ArmScript.exercise_wrist``, and find where the jaws are closed."""
        await together(self.hand.exercise_wrist, partial(self.hand.zero_jaw, self.settings.jaw_closed_rad))

    async def go_to(
        self, grasp: Grasp, source: int, ready: Approach | None, begun: Callable[[Approach], None] | None
    ) -> bool:
        """Travel over the pegs, then down round the wall of a block with open jaws; False if no motion does it.

        ``ready`` is the motion, if already planned; it is planned again if it no longer fits. ``begun`` is called with
        the motion when it begins.
        """
        opening = self.opening_rad(grasp)
        if self.before_descent is not None:
            await self.before_descent(grasp, opening)
            ready = None
        for margin_m in self.margins_m():
            if ready is None or not starts_at(ready.path, self.hand.q):
                ready = await self.plan(lambda: self.motions.approach(self.hand.q, grasp, source))
            if ready is None:
                return False
            try:
                await self.move(
                    ready.path.trajectory,
                    begun=begun and partial(begun, ready),
                    jaw_rad=opening,
                    margin_m=margin_m,
                    departure=ready.departure,
                )
            except Blocked:
                await self.give_way()
                continue
            await self.hand.settle()
            return True
        raise Blocked(self.name)

    def opening_rad(self, grasp: Grasp) -> float:
        """Return how wide the jaws open for a grasp."""
        return float(np.clip(grasp.jaw_rad, self.settings.release_rad, self.settings.jaw_open_rad))

    async def go_over(self, T_board_tip: SE3, *, waits: bool = True) -> None:
        """Travel to a pose over the pegs; ``waits`` as in :meth:`move`."""
        if np.linalg.norm(T_board_tip.translation_m - self.T_board_tip.translation_m) < AT_HEIGHT_M:
            return
        path = await self.plan(lambda: self.motions.over(self.hand.q, T_board_tip))
        if path is not None:
            await self.move(path.trajectory, waits=waits)

    async def grip(self, T_tip_block: SE3) -> bool:
        """Close the jaws; return whether they hold something, which is taken to be the block at ``T_tip_block``."""
        stopped_rad = await self.hand.close_on(self.settings.jaw_grip_rad)
        self.table.wall.learn(stopped_rad)
        holds = self.table.wall.fits(stopped_rad)
        self.coordinator.carry(self.name, self.motions.held(T_tip_block) if holds else None)
        return holds

    async def open(self, jaw_rad: float | None = None) -> None:
        """Open the jaws; None: just far enough to release what they hold, since a peg may be beside a finger."""
        most_rad = MOST_RELEASE_RAD if self.hands_over else self.settings.jaw_open_rad
        lets_go = np.clip(self.hand.jaw_rad + LETS_GO_RAD, self.settings.release_rad, most_rad)
        await self.hand.part(float(lets_go) if jaw_rad is None else jaw_rad)
        self.coordinator.carry(self.name, None)
        if self.after_release is not None:
            self.after_release()

    async def carry(
        self,
        T_tip_block: SE3,
        source: int | None,
        target: int,
        ready: Carriage | None = None,
        begun: Callable[[Carriage], None] | None = None,
    ) -> SE3 | None:
        """Lift a block, travel and lower it; return where it should be now, or None if no pose is in reach.

        ``source`` is the peg on which it still stands; None: it is in the air. ``ready`` is the motion, if already
        planned; it is planned again if it no longer fits. ``begun`` is called with the motion when it begins.
        """
        hangs_over_target = False
        for margin_m in self.margins_m():
            if not hangs_over_target and (ready is None or not self._fits(ready, target)):
                ready = await self.plan(lambda: self.motions.carriage(self.hand.q, T_tip_block, source, target))
            if ready is None:
                return None
            try:
                if not hangs_over_target:
                    await self.move(
                        ready.path.trajectory,
                        begun=begun and partial(begun, ready),
                        margin_m=margin_m,
                        departure=ready.departure,
                        loosens=not self.settings.waits_for_jaws,
                    )
                    await self.hand.settle()
                if not self.settings.looks_before_placing:
                    return ready.T_board_placed
                hangs_over_target = True
                return await self._lower(T_tip_block, target, ready.departure)
            except Blocked:
                await self.give_way()
        raise Blocked(self.name)

    async def _lower(self, T_tip_block: SE3, target: int, planned: Departure) -> SE3:
        """Look how a block hangs over its target, lower it, and return where it should be now.

        If the corrected pose is out of reach, it is lowered as planned before the look.
        """
        T_tip_block = await self.eyes.see_own(T_tip_block)
        for margin_m in self.margins_m():
            path = await self.plan(lambda: self.motions.lowering(self.hand.q, T_tip_block, target))
            motion = self.motions.prepared(planned.motion) if path is None else path.trajectory
            try:
                await self.move(motion, margin_m=margin_m)
            except Blocked:
                await self.cell.clock.sleep(PAUSE_S)
                continue
            await self.hand.settle()
            return self.T_board_tip @ T_tip_block
        raise Blocked(self.name)

    def _fits(self, carriage: Carriage, target: int) -> bool:
        """Return whether a motion planned before still starts here, with the same blocks beside its target."""
        pegs = self.table.board.pegs_m
        near = [peg for peg in range(len(pegs)) if np.linalg.norm(pegs[peg] - pegs[target]) < BESIDE_M]
        now, then = self.table.blocks, carriage.beside
        return starts_at(carriage.path, self.hand.q) and all(now.get(peg) is then.get(peg) for peg in near)

    async def let_go(self) -> None:
        """Open the jaws and rise above the pegs."""
        await self.open()
        await self.retreat()

    async def retreat(self) -> None:
        """Rise above the pegs."""
        if self.height_m < self.settings.clear_height_m - AT_HEIGHT_M:
            path = await self.plan(lambda: self.motions.through(self.motions.risen(self.hand.q)))
            if path is not None:
                await self.move(path.trajectory, margin_m=self.settings.min_margin_m)

    async def shift(
        self, line_m: Sequence[float], margin_m: float, contact_s: tuple[float, float] = NEVER, waits: bool = True
    ) -> None:
        """Move the tip straight, in the board's axes; the other arguments as in :meth:`move`."""
        motion = await self.plan(lambda: self.motions.along(self.hand.q, line_m))
        if motion is not None:
            await self.move(motion, margin_m=margin_m, contact_s=contact_s, waits=waits)

    async def go_home(self, begun: Callable[[TimedPath], None] | None = None) -> None:
        """Rise and leave the camera's view of the board; ``begun`` is called with the motion when it begins."""
        if np.abs(self.hand.q - self.home).max() < AT_HOME:
            return
        path = await self.plan(lambda: self.motions.to_joints(self.hand.q, self.home))
        if path is not None:
            await self.move(path.trajectory, begun=begun and partial(begun, path))

    def margins_m(self) -> list[float]:
        """Return the margins to the other arm that are tried in turn."""
        return [self.settings.margin_m] + [self.settings.min_margin_m] * self.settings.detours

    async def give_way(self) -> None:
        """Make room for the other arm: go home, or at least rise; wait if the arm can do neither, or holds a block."""
        self.cell.log.event("gives way", arm=self.name)
        for leave in () if self.coordinator.carries(self.name) else (self.go_home, self.retreat):
            with suppress(Blocked):
                return await leave()
        await self.cell.clock.sleep(PAUSE_S)

    async def move(
        self,
        motion: Trajectory,
        *,
        begun: Callable[[], None] | None = None,
        jaw_rad: float | None = None,
        margin_m: float | None = None,
        contact_s: tuple[float, float] = NEVER,
        departure: Departure | None = None,
        waits: bool = True,
        loosens: bool = False,
    ) -> None:
        """Run a motion as soon as the other arm leaves room for it, and meanwhile drive the jaws.

        Args:
            motion: starts where the arm is at rest.
            begun: called when it begins.
            jaw_rad: opening of the jaws once the arm has risen over the pegs; None: as they are.
            margin_m: to keep to the other arm; None: the default.
            contact_s: interval of the motion in which the jaws may touch the block in the other arm's jaws.
            departure: how the arm gets away from where the motion ends.
            waits: whether to wait until the other arm does something else, if its announced motion leaves no room.
            loosens: whether the jaws loosen their grip just before the end, where they are to release what they hold.

        Raises:
            Blocked: the other arm is in the way, and waiting does not help; or the robot refuses to move beside it.
            ArmStopped: the arm did not reach the end.
            MotionRefused: the robot refuses the motion of an arm that is alone.
        """
        await self.coordinator.admit(
            self.name,
            motion,
            jaw_rad=max(0.0, self.hand.jaw_rad, self.hand.jaw_goal_rad, jaw_rad or 0.0),
            margin_m=margin_m,
            contact_s=contact_s,
            departure=departure,
            waits=waits,
        )
        self.bound_for = motion(motion.times_s[-1])
        if begun is not None:
            begun()
        ended = trio.Event()
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self.hand.go_on_with_jaw)
            if jaw_rad is not None:
                nursery.start_soon(self._drive_jaw_once_risen, jaw_rad, ended)
            if loosens:
                nursery.start_soon(self._loosen, motion.duration_s, ended)
            try:
                result = await self.coordinator.run(self.name, motion)
            except MotionRefused as error:
                result = error
            ended.set()
        if isinstance(result, MotionRefused):
            if self.coordinator.alone:
                raise result
            self.cell.log.event("refused", arm=self.name, reason=str(result))
            raise Blocked(self.name)
        if not result.done:
            raise ArmStopped(self.name, result.reason)

    async def _drive_jaw_once_risen(self, jaw_rad: float, ended: trio.Event) -> None:
        """Drive the jaws as soon as the arm has risen over the pegs, or its motion has ended."""
        while self.height_m < self.table.board.peg_height_m + AT_HEIGHT_M and not ended.is_set():
            await self.cell.clock.sleep(TICK_S)
        await self.hand.drive_jaw(jaw_rad)

    async def _loosen(self, duration_s: float, ended: trio.Event) -> None:
        """Loosen the grip at the end of a motion, so that the jaws part as soon as they are told to.

        A drive that presses is commanded far beyond the wall. Jaws that lost the block stay closed, so that it is seen.
        """
        lead_s = (self.hand.jaw_rad - self.settings.jaw_grip_rad) / self.model.jaw.max_speed + JAW_REST_S
        with trio.move_on_after(max(0.0, duration_s - lead_s)):
            await ended.wait()
        if not ended.is_set() and self.holds:
            await self.hand.loosen_jaw()

    async def plan(self, compute: Callable[[], Result]) -> Result | None:
        """Plan a motion; None, with the reason in the log, if a pose or the path to it leaves the joints' ranges."""

        def attempt() -> Result | None:
            try:
                return compute()
            except MotionRefused as error:
                self.cell.log.event("no motion", arm=self.name, reason=str(error))
                return None

        return await self.hand.compute("planning", self.settings.planning_budget_s, attempt)
