"""Agents of the peg transfer: one for each variant."""

from __future__ import annotations

from trocar.registry import Lazy
from trocar.tasks.kit import Agent, Brief

AGENTS = {
    "unilateral": Lazy("trocar.tasks.peg_transfer.agents.unilateral:Unilateral"),
    "bilateral": Lazy("trocar.tasks.peg_transfer.agents.bilateral:Bilateral"),
    "handover": Lazy("trocar.tasks.peg_transfer.agents.handover:Handover"),
}


def agent_of(brief: Brief) -> Agent:
    """Return the agent of the variant that a brief is about."""
    return AGENTS[brief.known.variant].load()(brief)
