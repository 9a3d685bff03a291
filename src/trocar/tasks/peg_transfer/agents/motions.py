"""Motions of one arm over the board, planned from where the arm rests or from where it will rest."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk, ik, ik_with_fixed_wrist
from trocar.errors import OutOfReach
from trocar.eval import AgentContext
from trocar.geometry import SE3, SO3
from trocar.geometry.capsules import Capsules
from trocar.motion import TimedPath, plan_through, rest_to_rest, straight
from trocar.robots.arm_script import ArmScript
from trocar.robots.traffic import Departure
from trocar.tasks.peg_transfer.agents.offset import TipOffset
from trocar.tasks.peg_transfer.agents.table import Table
from trocar.tasks.peg_transfer.grasps import Grasp, choose_place, held_block, hole_over, yaw_of
from trocar.tasks.peg_transfer.shapes import Block
from trocar.trajectory import Trajectory

Joints = NDArray[np.float64]

AT_HEIGHT_M = 1e-3
NEARBY_M = 25e-3
"""An arm that has risen out of a block keeps its height on the way to its next grasp if that is nearer than this."""
OVER_M = 4e-3
"""An arm whose tip is this close to a grasp horizontally, and higher by more, goes straight down."""
MAX_TURNED_RAD = 0.15
"""A tool whose rotation differs from the grasp's by more than this is turned before it goes down."""
OFFERED_LIFT_M = 21.5e-3
"""A block that will be offered first rises straight up by this much, just off its peg, then follows a curve. The
shorter the straight part, the lower the top of the curve: it has to pass below the waiting arm."""
CENTRED = 2
"""Number of iterations that bring a hole to its place; the second leaves an error of some micrometres."""
LAYERS = 3
"""Number of heights at which the sides of a held block are modelled as capsules."""
SAME_RAD = 1e-6
"""Joints this close (rad, m) to the planned start count as being there."""


@dataclass(frozen=True, eq=False)
class Approach:
    """A motion to a block's wall."""

    path: TimedPath  # over the pegs, then down
    departure: Departure | None  # how the arm then lifts the block; None: no block is known to be there


@dataclass(frozen=True, eq=False)
class Carriage:
    """A motion that brings a block to its target."""

    path: TimedPath  # lift, travel, lower
    T_board_placed: SE3  # where the block comes to lie
    departure: Departure  # how the arm then rises from it
    beside: dict[int, SE3]  # the other blocks, by peg, as known when this was planned


def starts_at(path: TimedPath, q: Joints) -> bool:
    """Return whether a motion starts at these joints (6,)."""
    return bool(np.abs(path.trajectory(path.trajectory.times_s[0]) - q).max() < SAME_RAD)


def end_of(path: TimedPath) -> Joints:
    """Return the joints (6,) at which a motion ends."""
    return path.trajectory(path.trajectory.times_s[-1])


class Motions:
    """Plans the motions of one arm, including their commands.

    Each starts from given joints, so it can be planned while the arm is still on its way to them.

    Attributes:
        offset: offset between the tip and its place according to the joints.
        T_world_base_registered: the base as registered, which the robot's guard uses for distances.
    """

    def __init__(self, context: AgentContext, hand: ArmScript, table: Table):
        self._robot, self.T_world_base_registered = context.cell.robot, context.cell.T_world_base_registered[hand.name]
        self._name, self._model, self._limits, self._table = hand.name, hand.model, hand.limits, table
        self._log, self._settings, self._planner = context.cell.log, context.settings, context.planner
        hands_over = context.nominal.variant == "handover"
        places_still = context.settings.looks_before_placing or not hands_over
        self._still_when_placing = context.settings.fixed_wrist and places_still
        self.offset = TipOffset()

    @property
    def T_world_base(self) -> SE3:
        """Return the base as corrected by ``offset``, so that joints and looks agree; at first as registered."""
        T_world_board, moved = self._table.T_world_board, SE3.from_parts(translation_m=[*self.offset.xy_m, 0.0])
        return T_world_board @ moved @ T_world_board.inverse() @ self.T_world_base_registered

    @property
    def T_base_board(self) -> SE3:
        """Return the pose of the board in the arm's base."""
        return self.T_world_base.inverse() @ self._table.T_world_board

    def tip(self, q: Joints) -> SE3:
        """Return the pose of the tip in the board's frame."""
        return self.T_base_board.inverse() @ fk(self._model, q)

    def ik(self, T_board_tip: SE3) -> Joints:
        """Return the joints (6,) that hold the tip there."""
        return ik(self._model, self.T_base_board @ T_board_tip)

    def through(self, points: Sequence[Joints], fixed_wrist: bool | None = None) -> TimedPath:
        """Return a motion through these joints; ``fixed_wrist``: None for that of the settings."""
        still = self._settings.fixed_wrist if fixed_wrist is None else fixed_wrist
        up, planner = self.T_base_board.matrix[:3, 2], self._planner
        plan = plan_through(self._model, np.array(points), self._limits, up=up, fixed_wrist=still, planner=planner)
        return TimedPath(self.prepared(plan.trajectory), next(iter(plan.waypoint_times_s.values())))

    def held(self, T_tip_block: SE3) -> Capsules:
        """Return the solids of a block in the jaws, in the frame of the tip."""
        return _sides(self._table.block).moved(T_tip_block)

    def prepared(self, motion: Trajectory) -> Trajectory:
        """Let the robot find the commands of a motion in advance; return the motion."""
        self._robot.prepare({self._name: motion})
        return motion

    def above(self, q: Joints, height_m: float) -> Joints:
        """Return joints that put the tip straight above (or below) its position at these joints, at another height."""
        return self._moved(q, raised(self.tip(q), height_m))

    def clear(self, q: Joints, T_tip_block: SE3, peg: int, height_m: float, placed: float | None = None) -> Joints:
        """Return joints that put the tip at another height, and the hole of the block in its jaws over a peg.

        By default, the hole's lower end, which passes the peg's top, is centred on the peg. To place a block, give
        ``placed``, a share of the hole's depth from the block's top face: the hole's middle at this depth is brought to
        where ``hole_over`` leaves room for the inner finger.
        """
        part, foot_m = 1.0 if placed is None else placed, self._table.board.pegs_m[peg]
        goal, depth_m = raised(self.tip(q), height_m), [0.0, 0.0, part * self._table.block.height_m]
        for _ in range(CENTRED):
            found = self._moved(q, goal)
            T_board_tip = self.tip(found)
            off_m = foot_m[:2] if placed is None else hole_over(foot_m, T_board_tip, T_tip_block)
            off_m = off_m - (T_board_tip @ T_tip_block).apply(depth_m)[:2]
            goal = SE3.from_parts(translation_m=[*off_m, 0.0]) @ goal
        return self._moved(q, goal)

    def _moved(self, q: Joints, T_board_tip: SE3) -> Joints:
        """Return joints that put the tip at a pose; with ``fixed_wrist``, only at its position, the wrist still."""
        if self._settings.fixed_wrist:
            with suppress(OutOfReach):
                return ik_with_fixed_wrist(self._model, q, self.T_base_board.apply(T_board_tip.translation_m))
        return self.ik(T_board_tip)

    def risen(self, q: Joints) -> list[Joints]:
        """Return the first waypoints of any motion: the arm's position, and one over the pegs if it is lower."""
        tip = self.tip(q)
        if tip.translation_m[2] >= self._settings.clear_height_m - AT_HEIGHT_M:
            return [q]
        return [q, self.above(q, self._settings.clear_height_m)]

    def approach(
        self, q: Joints, grasp: Grasp, source: int, rise_m: float = 0.0, aside_m: float | None = None
    ) -> Approach:
        """Return how to travel over the pegs, then down round the wall of a block.

        The arm first goes up by ``rise_m`` and, if ``aside_m`` is given, then sideways by it along the board's x.
        """
        tip, over_m, first = self.tip(q), self._settings.clear_height_m, self.risen(q)
        off = tip.translation_m - grasp.T_board_tip.translation_m
        down = self.ik(grasp.T_board_tip)
        if np.linalg.norm(off[:2]) < OVER_M < off[2]:  # it is already waiting over the block
            over_m, first = float(tip.translation_m[2]), [q]
            if self._settings.fixed_wrist and turned_rad(tip, grasp.T_board_tip) < MAX_TURNED_RAD:
                down = self._moved(q, grasp.T_board_tip)
        if rise_m:
            risen_m = float(tip.translation_m[2]) + rise_m
            first = [q, self.above(q, risen_m)]
            if aside_m is not None:
                first.append(self._moved(q, SE3.from_parts(translation_m=[aside_m, 0.0, rise_m]) @ tip))
            elif np.linalg.norm(off[:2]) < NEARBY_M:
                over_m = risen_m
        over = self.above(down, over_m)
        if np.abs(over - first[-1]).max() < SAME_RAD:
            first.pop()
        return Approach(self.through([*first, over, down]), self._departure(down, source))

    def _departure(self, q: Joints, source: int) -> Departure | None:
        """Return how the arm lifts the block that it is about to grasp at these joints."""
        block = self._table.blocks.get(source)
        if block is None:
            return None
        lifted = self.above(q, float(self.tip(q).translation_m[2]) + self._settings.lift_m)
        return Departure(rest_to_rest(q, lifted, self._limits), self.held(self.gripped(q, block)))

    def carriage(self, q: Joints, T_tip_block: SE3, source: int | None, target: int) -> Carriage | None:
        """Return how to lift a block, travel and lower it; None, with the reason in the log, if no pose is possible.

        Args:
            q: (6,) joints with the block in the jaws.
            T_tip_block: pose of the block there.
            source: peg on which it still stands; None: it is in the air.
            target: peg to which it goes.
        """
        settings, board, block = self._settings, self._table.board, self._table.block
        tip, beside = self.tip(q), {peg: pose for peg, pose in self._table.blocks.items() if peg != source}
        others, yaw_rad = list(beside.values()), yaw_of(tip)
        place = choose_place(
            self._model, self.T_base_board, T_tip_block, board, block, target, others, settings.drop_m, yaw_rad
        )
        if isinstance(place, str):
            self._log.event("no place", peg=target, reason=place)
            return None
        height = place.translation_m[2] - settings.drop_m + settings.lift_m
        points = [q]
        if tip.translation_m[2] < height - AT_HEIGHT_M:
            points.append(self._over(q, T_tip_block, source, height))
        down = self.ik(place)
        points.append(self._over(down, T_tip_block, target, height))
        if settings.looks_before_placing:
            departure = Departure(rest_to_rest(points[-1], down, self._limits), self.held(T_tip_block))
        else:
            points.append(down)
            departure = Departure(rest_to_rest(down, self.above(down, settings.clear_height_m), self._limits))
        return Carriage(self.through(points, self._still_when_placing), place @ T_tip_block, departure, beside)

    def lowering(self, q: Joints, T_tip_block: SE3, target: int) -> TimedPath:
        """Return how to lower a block that hangs over its target: first sideways until its hole is over the peg."""
        low_end, height_m = [0.0, 0.0, self._table.block.height_m], float(self.tip(q).translation_m[2])
        over = down = self.clear(q, T_tip_block, target, height_m)
        for _ in range(CENTRED):  # a block that turns with the shaft descends by a different amount than the tip
            height_m += self._settings.drop_m - float((self.tip(down) @ T_tip_block).apply(low_end)[2])
            down = self.clear(over, T_tip_block, target, height_m, placed=0.5)
        return self.through([q, over, down])

    def _over(self, q: Joints, T_tip_block: SE3, peg: int | None, height_m: float) -> Joints:
        """Return joints at a height above those that hold a block round a peg, such that the block clears the peg."""
        if not self._still_when_placing:
            return self.ik(raised(self.tip(q), height_m))
        return self.above(q, height_m) if peg is None else self.clear(q, T_tip_block, peg, height_m)

    def over(self, q: Joints, T_board_tip: SE3) -> TimedPath:
        """Return how to travel to a pose over the pegs."""
        return self.through([*self.risen(q), self.ik(T_board_tip)])

    def hovering(self, q: Joints, T_board_tip: SE3, height_m: float) -> TimedPath:
        """Return how to travel over the pegs, then down to a height over a pose."""
        below, first = self.ik(T_board_tip), self.risen(q)
        over, down = (self.above(below, height) for height in (self._settings.clear_height_m, height_m))
        if np.linalg.norm(self.tip(first[-1]).translation_m - self.tip(over).translation_m) < AT_HEIGHT_M:
            return self.through([*first, down])  # the arm is over the pose already
        return self.through([*first, over, down])

    def offering(self, q: Joints, T_tip_block: SE3, source: int, T_board_tip: SE3) -> TimedPath:
        """Return how to lift a block from its peg, unless it is in the air already, and bring it to the handover."""
        height_m, still = float(self.tip(q).translation_m[2]), self._settings.fixed_wrist
        if height_m > self._settings.clear_height_m:
            return self.through([q, self.ik(T_board_tip)])
        height_m += OFFERED_LIFT_M
        lifted = self.clear(q, T_tip_block, source, height_m) if still else self.above(q, height_m)
        return self.through([q, lifted, self.ik(T_board_tip)])

    def along(self, q: Joints, line_m: Sequence[float]) -> Trajectory:
        """Return a motion of the tip along a straight line, in the board's axes."""
        line = self.T_base_board.rotation.apply(np.array(line_m))
        return self.prepared(straight(self._model, q, line, self._limits))

    def to_joints(self, q: Joints, goal: Joints) -> TimedPath:
        """Return a motion that rises over the pegs and goes to joints (6,)."""
        start, *above = self.risen(q)
        if not above:
            return TimedPath.joined([self.prepared(rest_to_rest(start, goal, self._limits))])
        return self.through([start, *above, goal])

    def gripped(self, q: Joints, T_board_block: SE3) -> SE3:
        """Return the pose of a block in the jaws that have closed on it at these joints.

        On the board it stands flat, which is more certain than the tilt seen in its image (within a degree).
        """
        upright = SO3.between(-T_board_block.matrix[:3, 2], [0.0, 0.0, 1.0]) @ T_board_block.rotation
        flat = SE3.from_parts(upright, T_board_block.translation_m)
        return held_block(self.tip(q), flat, self._table.block)


def raised(T_board_tip: SE3, height_m: float) -> SE3:
    """Return a pose of the tip at another height over the plate."""
    x, y, _ = T_board_tip.translation_m
    return SE3.from_parts(T_board_tip.rotation, [x, y, height_m])


def turned_rad(T_board_a: SE3, T_board_b: SE3) -> float:
    """Return the angle between two poses' rotations."""
    return float(np.linalg.norm((T_board_a.rotation.inverse() @ T_board_b.rotation).log()))


def _sides(block: Block) -> Capsules:
    """Return the sides of a block between its corners' circles, at some heights, as capsules in its frame."""
    corners = block.corners_m()
    sides = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    inset = block.corner_radius_m / 2
    heights = np.linspace(inset, block.height_m - inset, LAYERS)
    ends = np.concatenate([sides + [0.0, 0.0, z] for z in heights])
    return Capsules(ends, np.full(len(ends), block.corner_radius_m))
