"""Scripts for debridement: the paper's way, and ours."""

from __future__ import annotations

from trocar.cell import Cell, Robot
from trocar.tasks.debridement.agents.adjusted import Adjusted
from trocar.tasks.debridement.agents.debriders import Debriders
from trocar.tasks.debridement.agents.settings import Settings
from trocar.tasks.debridement.pose import ErrorFilter, FilterSettings, PaperAdjustment
from trocar.tasks.kit import Brief

STEADY = FilterSettings(
    drift_m=0.002,
    drift_rad=0.03,
    drift_s=60.0,
    lag_gain=0.2,
    turn_gain=0.2,
    tool_m=0.003,
    noise_m=0.001,
    noise_rad=0.02,
)
"""Gains that inverse control can invert: cables with play do not pass on small turns, and a filter that may believe
that no turn is passed on at all has no inverse."""
ESTIMATORS = {"filter": lambda: ErrorFilter(STEADY), "paper": PaperAdjustment}


def with_adjustment(cell: Cell, settings: Settings) -> Robot:
    """Return the cell's robot with its kinematics put right by what the camera sees."""
    return Adjusted(cell, ESTIMATORS[settings.estimator])


def agent_of(brief: Brief) -> Debriders:
    """Return the agent of a trial."""
    return Debriders(brief)


__all__ = ["STEADY", "Debriders", "agent_of", "with_adjustment"]
