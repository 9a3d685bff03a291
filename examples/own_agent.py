"""A method of your own for the peg transfer: an agent that looks at a block once more before it lets go of it.

trocar run --plugin examples/own_agent.py peg-transfer --method second-look --trials 1 --seed 3 --out out/second-look
"""

from __future__ import annotations

from dataclasses import dataclass

from trocar.eval import METHODS, Method
from trocar.tasks.peg_transfer.agents import Settings
from trocar.tasks.peg_transfer.agents.unilateral import Unilateral
from trocar.tasks.peg_transfer.goals import Transfer


@dataclass(frozen=True)
class PatientSettings(Settings):
    """As the built-in agent's, with a longer rest before the jaws act."""

    settle_s: float = 0.12


class SecondLook(Unilateral):
    """Does what the built-in agent does, and takes a picture before it releases a block."""

    async def before_release(self, goal: Transfer) -> None:
        """Take an image and log its time."""
        image = await self.table.capture(self.arm.hand)
        self.cell.log.event("second look", peg=goal.target, time_of_image_s=image.time_s)


METHODS.register(
    "peg-transfer/second-look",
    Method("looks before it lets go", SecondLook, PatientSettings, calibrated=True, perception="depth"),
)
