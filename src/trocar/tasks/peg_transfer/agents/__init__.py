"""Agents of the peg transfer: one for each variant."""

from __future__ import annotations

from trocar.eval import Agent, AgentContext
from trocar.registry import Lazy

AGENTS = {
    "unilateral": Lazy("trocar.tasks.peg_transfer.agents.unilateral:Unilateral"),
    "bilateral": Lazy("trocar.tasks.peg_transfer.agents.two_arms:Bilateral"),
    "handover": Lazy("trocar.tasks.peg_transfer.agents.two_arms:Handover"),
}


def agent_of(context: AgentContext) -> Agent:
    """Return the agent of the variant that a context is about."""
    return AGENTS[context.nominal.variant].load()(context)
