"""Planning problems for one arm of the pair, and its obstacles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trocar.arms import MotionLimits, fk, ik
from trocar.cell import Cell
from trocar.geometry import SE3
from trocar.motion import ArmMotion, Facing, HalfSpace, MotionProblem, Obstacle, open_box
from trocar.motion.clearance import swept_clearance
from trocar.motion.moving_arm import MovingArm
from trocar.tasks.debridement.agents.adjusted import Adjusted
from trocar.tasks.debridement.agents.eyes import CAMERA
from trocar.tasks.debridement.workspace import Workspace
from trocar.trajectory import Trajectory

JAW_AXIS = (0.0, 1.0, 0.0)
"""Axis in the tip's frame along which the discs of the marks face."""
MAX_FACING_RAD = np.radians(75.0)
"""Beyond this angle the marks are seen too much from the side."""
SUNK_M = 2.5e-3
"""For planning, the work surface is lowered by this and the margin: a finger's capsule is that much thicker than its
end, and arms come close to the surface to take fragments."""


HIGHER_M = 10e-3
"""For planning, the receptacle's walls are this much higher, because a carried fragment hangs lower than the
fingers."""


@dataclass(frozen=True)
class Asked:
    """One arm's next motion.

    Attributes:
        T_world_goal: where its tip is to go.
        speed_m_s: of the tip at most.
        straight: a short piece down to a fragment or up from it: the fingers may be near the work surface.
        beside_wall: a place so close to the receptacle that the true height of its walls has to be used.
        T_world_through: a pose of the tip to pass on the way without a stop; None: none.
    """

    T_world_goal: SE3
    speed_m_s: float
    straight: bool = False
    beside_wall: bool = False
    T_world_through: SE3 | None = None


@dataclass(frozen=True, eq=False)
class Problems:
    """Makes motion problems from requests, starting from the estimated state of everything.

    Attributes:
        cell: the laboratory.
        robot: the same robot, which estimates where the arms are.
        known: the workspace.
        limits: of velocity and acceleration, by arm.
        margin_m: to keep between arms and to obstacles.
    """

    cell: Cell
    robot: Adjusted
    known: Workspace
    limits: Mapping[str, MotionLimits]
    margin_m: float

    @cached_property
    def table(self) -> HalfSpace:
        """Return the distance to keep from the work surface."""
        T_world_table = self.cell.T_world_fixture["table"]
        normal = T_world_table.rotation.matrix[:, 2]
        return HalfSpace(T_world_table.translation_m - (SUNK_M + self.margin_m) * normal, normal)

    def obstacles(self, beside_wall: bool) -> dict[str, Obstacle]:
        """Return work surface and receptacle as obstacles, for travelling or for going down beside a wall."""
        box = self.known.receptacle
        height_m = box.height_m + (0.0 if beside_wall else HIGHER_M)
        T_world_receptacle = self.cell.T_world_fixture["receptacle"]
        walls = open_box("receptacle", T_world_receptacle, inside_m=box.size_m, height_m=height_m, radius_m=box.wall_m)
        return {"table": self.table, **walls}

    def of(self, asked: Mapping[str, Asked], delay_s: float) -> MotionProblem:
        """Return the problem of these arms beside the others, for motions that start ``delay_s`` from now."""
        others = {name: self._other(name, delay_s) for name in self.cell.arms if name not in asked}
        free = all(not a.straight for a in asked.values())
        return MotionProblem(
            {name: self._motion(name, a) for name, a in asked.items()},
            others=others,
            obstacles=self.obstacles(any(a.beside_wall for a in asked.values())) if free else {},
            min_distance_m=self.margin_m,
        )

    def clear(self, name: str, T_world_tip: SE3, jaw_rad: float, beside_wall: bool) -> bool:
        """Return whether an arm at rest there, with this jaw opening, is clear of work surface and receptacle."""
        model, T_world_base = self.cell.arms[name], self.cell.T_world_base_registered[name]
        q = ik(model, T_world_base.inverse() @ T_world_tip, reference=self.robot.setpoint(name).q)
        there = MovingArm.resting(model, q, T_world_base, jaw_rad)
        found = swept_clearance({name: there}, obstacles=self.obstacles(beside_wall), enough_m=self.margin_m)
        return found.distance_m >= self.margin_m

    def _motion(self, name: str, asked: Asked) -> ArmMotion:
        model, T_world_base = self.cell.arms[name], self.cell.T_world_base_registered[name]
        q = self.robot.setpoint(name).q
        through = () if asked.T_world_through is None else (asked.T_world_through,)
        T_world_goals = SE3.unchecked(np.stack([T.matrix for T in (*through, asked.T_world_goal)]))
        T_world_camera = self.cell.T_world_camera_registered[CAMERA]
        facing = Facing(np.array(JAW_AXIS), T_world_camera.translation_m, float(MAX_FACING_RAD))
        within = all(
            facing.angle_rad(T) < MAX_FACING_RAD for T in (asked.T_world_goal, T_world_base @ fk(model, q))
        )  # an arm whose marks cannot be seen now has to come back first
        return ArmMotion(
            model,
            q[None],
            self.limits[name],
            T_world_base=T_world_base,
            T_base_goals=T_world_base.inverse() @ T_world_goals,
            jaw_rad=self.robot.read(name).jaw_rad,
            max_tip_m_s=asked.speed_m_s,
            facing=facing if within else None,
        )

    def _other(self, name: str, delay_s: float) -> MovingArm:
        model, T_world_base = self.cell.arms[name], self.cell.T_world_base_registered[name]
        jaw_rad, course = self.robot.read(name).jaw_rad, self.robot.course(name)
        if course is None:
            return MovingArm.resting(model, self.robot.setpoint(name).q, T_world_base, jaw_rad)
        trajectory, began_s = course
        shift = self.robot.setpoint(name).q - trajectory(self.robot.setpoint(name).path_s)
        coefficients = trajectory.coefficients.copy()
        coefficients[-1] += shift
        start_s = began_s - self.cell.clock.now_s() - delay_s
        return MovingArm(model, Trajectory(trajectory.times_s, coefficients), T_world_base, start_s, jaw_rad)
