"""Scripts for debridement, for the paper's method and for ours: one script for each working arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from trocar.arms import ArmModel
from trocar.cell import Cell, Robot
from trocar.errors import InvalidInput
from trocar.eval import AgentContext
from trocar.robots.coordinator import Coordinator
from trocar.tasks.debridement.agents.adjusted import Adjusted
from trocar.tasks.debridement.agents.allocation import Allocation
from trocar.tasks.debridement.agents.debrider import Debrider, run_all
from trocar.tasks.debridement.agents.motions import MotionProblems, MotionRunner
from trocar.tasks.debridement.agents.observer import StereoObserver
from trocar.tasks.debridement.agents.places import Places
from trocar.tasks.debridement.agents.raven_arm import RavenArm
from trocar.tasks.debridement.agents.settings import Settings
from trocar.tasks.debridement.pose import ErrorField, PaperAdjustment, PoseEstimator

ESTIMATORS: Mapping[str, Callable[[ArmModel], PoseEstimator]] = {
    "field": ErrorField,
    "paper": lambda arm: PaperAdjustment(),
}


def with_adjustment(cell: Cell, settings: Settings) -> Robot:
    """Return the cell's robot with its kinematics corrected by what the camera sees."""
    return Adjusted(cell, ESTIMATORS[settings.estimator])


class DebridementAgent:
    """Clears the work surface with all working arms.

    Raises:
        InvalidInput: the cell's robot is not an ``Adjusted`` one, or the settings are another task's.
    """

    def __init__(self, context: AgentContext):
        cell, settings, robot = context.cell, context.settings, context.cell.robot
        if not isinstance(robot, Adjusted):
            problem = "needs a robot that is adjusted by what a camera sees"
            raise InvalidInput("debridement", problem, "wrap it in Adjusted")
        if not isinstance(settings, Settings):
            raise InvalidInput("debridement", f"needs its own settings, got {type(settings).__name__}")
        table, receptacle = cell.T_world_fixture["table"], cell.T_world_fixture["receptacle"]
        places = Places(table, receptacle, settings)
        coordinator = Coordinator(cell, context.arms)
        allocation = Allocation(coordinator, context.nominal, table, receptacle, len(context.goals))
        observer = StereoObserver(cell, context.perception, robot, settings)
        problems = MotionProblems(cell, robot, context.nominal, settings)
        runner = MotionRunner(problems, coordinator, context.planner)
        arms = [RavenArm(name, observer, runner, places, settings) for name in context.arms]
        self._debriders = [Debrider(arm, allocation) for arm in arms]

    async def run(self) -> None:
        """Clear all fragments that can be cleared."""
        await run_all(self._debriders)
