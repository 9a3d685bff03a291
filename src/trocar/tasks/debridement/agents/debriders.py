"""The agent: one script for each arm that works."""

from __future__ import annotations

from trocar.arms import MotionLimits
from trocar.errors import TrocarError
from trocar.eval import AgentContext
from trocar.tasks.debridement.agents.adjusted import Adjusted
from trocar.tasks.debridement.agents.debrider import Debrider, work
from trocar.tasks.debridement.agents.eyes import Eyes
from trocar.tasks.debridement.agents.fleet import Fleet
from trocar.tasks.debridement.agents.motion_asked import Problems
from trocar.tasks.debridement.agents.movers import Beside, Mover, Together
from trocar.tasks.debridement.agents.places import Places
from trocar.tasks.debridement.agents.raven_arm import RavenArm
from trocar.tasks.debridement.agents.settings import Settings


class Debriders:
    """Clears the work surface with all working arms.

    Raises:
        TrocarError: the robot of the cell does not estimate where its joints are.
    """

    def __init__(self, context: AgentContext):
        cell, settings, robot = context.cell, context.settings, context.cell.robot
        if not isinstance(robot, Adjusted):
            raise TrocarError("debridement needs a robot that is adjusted by what a camera sees; wrap it in Adjusted")
        if not isinstance(settings, Settings):
            raise TrocarError(f"debridement needs its own settings, got {type(settings).__name__}")
        fixture = cell.T_world_fixture
        places = Places(fixture["table"], fixture["receptacle"], settings)
        sides = {name: places.side(T) for name, T in cell.T_world_base_registered.items()}
        fleet = Fleet(context.nominal, fixture["table"], fixture["receptacle"], sides, len(context.goals))
        eyes = Eyes(cell, context.perception, robot, settings)
        share = settings.limits_share
        limits = {
            name: MotionLimits(share * model.motion_limits.velocity, share * model.motion_limits.acceleration)
            for name, model in cell.arms.items()
        }
        problems = Problems(cell, robot, context.nominal, limits, settings.margin_m)
        mover: Mover = (
            Together(cell, robot, problems, context.planner, settings, set(context.arms))
            if settings.centralised
            else Beside(cell, robot, problems, context.planner, settings)
        )
        self._debriders = [
            Debrider(RavenArm(problems, name, eyes, mover, places, settings), fleet) for name in context.arms
        ]

    async def run(self) -> None:
        """Clear all fragments that can be cleared."""
        await work(self._debriders)
