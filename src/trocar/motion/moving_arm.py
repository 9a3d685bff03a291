"""An arm whose motion is known: moving or at rest."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, capsules
from trocar.errors import InvalidInput
from trocar.geometry import SE3
from trocar.geometry.se3 import one_pose
from trocar.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class MovingArm:
    """An arm on a trajectory, in the world; it rests before and after.

    >>> waiting = MovingArm.resting(arm, q_now, T_world_right)
    >>> MovingArm(arm, trajectory, T_world_left, start_s=-0.2).ends_m(0.0).shape  # has been moving for .2 s
    (4, 2, 3)

    Attributes:
        model: of the arm.
        trajectory: of its six joints, without jumps; its own time starts at its first knot.
        T_world_base: pose of its base.
        start_s: when it starts, on the caller's clock; below 0 if it is already running.
        jaw_rad: opening between the fingers.
    """

    model: ArmModel
    trajectory: Trajectory
    T_world_base: SE3 = field(default_factory=SE3.identity)
    start_s: float = 0.0
    jaw_rad: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_world_base", one_pose(f"T_world_base of {self.model.name}", self.T_world_base))
        joints = self.trajectory.coefficients.shape[2]
        if joints != len(self.model.joints):
            raise InvalidInput(self.model.name, f"has {len(self.model.joints)} joints, its trajectory {joints}")
        if not (np.isfinite(self.start_s) and np.isfinite(self.jaw_rad)):
            raise InvalidInput(
                "a motion",
                f"of {self.model.name} starts at {self.start_s} s, jaws at {self.jaw_rad} rad",
                "give finite numbers",
            )

    def __repr__(self) -> str:
        return f"<MovingArm {self.model.name} from {self.start_s:.3f} s to {self.end_s:.3f} s>"

    @classmethod
    def resting(cls, model: ArmModel, q: ArrayLike, T_world_base: SE3 | None = None, jaw_rad: float = 0.0) -> MovingArm:
        """Return an arm that stays at these joints (6,)."""
        hold = Trajectory(np.array([0.0, 1e-3]), model.configurations(q)[None, None])
        return cls(model, hold, T_world_base or SE3.identity(), 0.0, jaw_rad)

    @property
    def end_s(self) -> float:
        """Return when it comes to rest."""
        return self.start_s + self.trajectory.duration_s

    @property
    def knots_s(self) -> NDArray[np.float64]:
        """Return the knots of its trajectory on the caller's clock."""
        return self.trajectory.times_s + (self.start_s - self.trajectory.times_s[0])

    def joints(self, t_s: ArrayLike, order: int = 0) -> NDArray[np.float64]:
        """Return the derivative of this order of the joints at the times (...,): (..., 6)."""
        shift = self.trajectory.times_s[0] - self.start_s
        return self.trajectory(np.asarray(t_s, dtype=np.float64) + shift, order)

    def ends_m(self, t_s: ArrayLike) -> NDArray[np.float64]:
        """Return the ends of the instrument's capsules in the world at the times (...,): (..., 4, 2, 3) m."""
        return capsules(self.model, self.joints(t_s), self.jaw_rad).moved(self.T_world_base).ends_m
