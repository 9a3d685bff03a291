"""How it is done: scripts that see, plan and act."""

from trocar.agents.peg_transfer import Settings, Unilateral
from trocar.agents.suture import CircleSuturing, SutureSettings

AGENTS = {("peg-transfer", "unilateral"): Unilateral, ("suture", "single-arm"): CircleSuturing}
"""Every script by the task and variant that it does."""

SETTINGS = {("peg-transfer", "unilateral"): Settings, ("suture", "single-arm"): SutureSettings}
"""The settings of every script; as they come they are the defaults."""

__all__ = ["AGENTS", "SETTINGS", "CircleSuturing", "Settings", "SutureSettings", "Unilateral"]
