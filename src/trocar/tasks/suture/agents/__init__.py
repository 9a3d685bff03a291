"""Agents of the sutures: one arm and a person, or two arms."""

from __future__ import annotations

from trocar.eval import AgentContext
from trocar.tasks.suture.agents.circle import CircleSuturing
from trocar.tasks.suture.agents.two_arms import TwoArmSuturing


def agent_of(context: AgentContext) -> CircleSuturing:
    """Return the agent for one or two arms, as many as work."""
    return (CircleSuturing if len(context.arms) == 1 else TwoArmSuturing)(context)
