"""How it is done: scripts that see, plan and act."""

from trocar.agents.peg_transfer import Settings, Unilateral

AGENTS = {("peg-transfer", "unilateral"): Unilateral}
"""Every script by the task and variant that it does."""

__all__ = ["AGENTS", "Settings", "Unilateral"]
