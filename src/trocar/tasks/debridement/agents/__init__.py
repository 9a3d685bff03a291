"""Scripts for debridement: the paper's method, and ours."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from trocar.arms import ArmModel
from trocar.cell import Cell, Robot
from trocar.eval import AgentContext
from trocar.tasks.debridement.agents.adjusted import Adjusted
from trocar.tasks.debridement.agents.debriders import Debriders
from trocar.tasks.debridement.agents.settings import Settings
from trocar.tasks.debridement.pose import ErrorField, PaperAdjustment, PoseEstimator

ESTIMATORS: Mapping[str, Callable[[ArmModel], PoseEstimator]] = {
    "field": ErrorField,
    "paper": lambda arm: PaperAdjustment(),
}


def with_adjustment(cell: Cell, settings: Settings) -> Robot:
    """Return the cell's robot with its kinematics corrected by what the camera sees."""
    return Adjusted(cell, ESTIMATORS[settings.estimator])


def agent_of(context: AgentContext) -> Debriders:
    """Return the agent of a trial."""
    return Debriders(context)


__all__ = ["Debriders", "agent_of", "with_adjustment"]
