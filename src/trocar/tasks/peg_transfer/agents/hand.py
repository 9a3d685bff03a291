"""An arm's script whose jaws open as wide as it asks, whatever the play in their cable."""

from __future__ import annotations

from dataclasses import dataclass, field

from trocar.cell import MotionResult
from trocar.robots.arm_script import ArmScript


@dataclass(eq=False)
class PegHand(ArmScript):
    """One arm as this task's scripts use it.

    The encoder of the jaws sits at their motor. Fingers that close follow it, as the zero of the readings does; to open
    them, it first has to go through the play.

    Attributes:
        jaw_play_rad: by how much jaws that have opened are narrower than their encoder says.
    """

    jaw_play_rad: float = 0.0
    _opened: bool = field(default=False, init=False)  # whether the jaws were last told to open

    @property
    def jaw_rad(self) -> float:
        """Return the opening between the fingers, as far as the encoder and the play tell it."""
        return super().jaw_rad - (self.jaw_play_rad if self._opened else 0.0)

    async def drive_jaw(self, angle_rad: float) -> MotionResult:
        """Drive the jaws to an opening; to open them, by the play further."""
        self._opened = angle_rad > self.jaw_rad
        return await super().drive_jaw(angle_rad + (self.jaw_play_rad if self._opened else 0.0))
