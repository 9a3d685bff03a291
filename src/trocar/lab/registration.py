"""How arms and cameras of a laboratory are registered to each other, as data."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from trocar.checks import require_numbers
from trocar.geometry import SE3, SO3, shown
from trocar.perception.checkerboard import Checkerboard


@dataclass(frozen=True)
class Registration:
    """A rigid fit of each base to points that robot and camera both know; the cameras are the world's reference.

    Attributes:
        points: number of points.
        sd_m: noise of each point on each axis.
        volume_m: corners of the box in the world in which they lie.
    """

    points: int = 270
    sd_m: float = 0.3e-3
    volume_m: tuple[tuple[float, float, float], tuple[float, float, float]] = ((-0.06, -0.04, 0.0), (0.06, 0.04, 0.05))

    def __post_init__(self) -> None:
        require_numbers(self)

    @property
    def about(self) -> str:
        """Return in words how well it finds a base."""
        return f"{self.points} points, {shown(self.sd_m, 'm', 'g')} an axis"


@dataclass(frozen=True, eq=False)
class CheckerboardRegistration:
    """A checkerboard on a bracket on each base in turn; the first arm's base is the world's reference.

    The camera's pose follows from the first arm's board, the other bases from theirs (Kehoe et al. 2014, IV-B).

    Attributes:
        board: that brackets and people hold.
        T_world_board: where each arm's bracket was made to hold it.
        sd_m: position error of a base as found, at the board, on each axis: bracket and images together.
        sd_rad: its rotation error about each axis.
        bracket_sd_m: position error with which a bracket holds the board, on each axis.
        bracket_sd_rad: its rotation error about each axis.
        views: number of poses in which a person shows the board for the lenses.
    """

    board: Checkerboard = field(default_factory=Checkerboard)
    T_world_board: SE3 = field(default_factory=lambda: SE3.from_parts(SO3.axis("y", math.pi)))
    sd_m: float = 0.3e-3
    sd_rad: float = math.radians(0.1)
    bracket_sd_m: float = 0.3e-3
    bracket_sd_rad: float = math.radians(0.1)
    views: int = 20

    def __post_init__(self) -> None:
        require_numbers(self)

    @property
    def about(self) -> str:
        """Return in words how well it finds a base."""
        return f"checkerboard, {shown(self.sd_m, 'm', 'g')} an axis and {shown(self.sd_rad, 'rad', 'g')} about each"
