"""A learned policy as a method of any task: ``trocar run TASK --method policy --policy WHAT``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trio

from trocar.errors import InvalidValue
from trocar.eval.method import AgentContext, Method
from trocar.learn.control import ABSOLUTE, STATE, Answer, Control
from trocar.learn.observed import Observation
from trocar.learn.policy import load_policy
from trocar.log import timed


@dataclass(frozen=True)
class PolicySettings:
    """Which policy is asked, what it observes, and how fast it acts."""

    policy: str = ""
    """What ``load_policy`` takes."""
    policy_digest: str = ""  # of the files of the policy with which this run began
    action: str = ABSOLUTE
    observation: str = STATE  # or objects, or images, or several: state,objects
    rate_hz: float = 30.0
    timeout_s: float = 10.0  # of the machine's clock, for loading it and for each answer

    def __post_init__(self) -> None:
        if self.timeout_s <= 0:
            raise InvalidValue("setting 'timeout_s'", self.timeout_s, "give seconds above 0")


class PolicyAgent:
    """Asks a policy for actions at a fixed rate, with the environment's observations, until the time is up.

    The cell's clock stands still while the policy computes. The log holds its computation time beside the period.
    """

    def __init__(self, context: AgentContext):
        self._cell, self._settings = context.cell, context.settings
        settings: PolicySettings = context.settings
        self._control = Control(context.cell, context.arms, settings.action, settings.rate_hz)
        parts = [part.strip() for part in settings.observation.split(",")]
        self._observation = Observation(context.cell, self._control, parts, context.objects)
        self._policy = load_policy(settings.policy, settings.policy_digest, settings.timeout_s)

    async def run(self) -> None:
        """Act until the policy answers None (it is done) or the budget is spent."""
        control, cell = self._control, self._cell
        with self._policy as ask:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self._observation.watch, cell)
                while (action := self._asked(ask)) is not None:
                    values = np.clip(control.checked(action), control.low, control.high)
                    answer = Answer()
                    nursery.start_soon(control.act, values, answer)
                    await control.step()
                    for arm, reason in answer.refused.items():
                        cell.log.event("refused", arm=arm, reason=reason)
                nursery.cancel_scope.cancel()

    def _asked(self, ask: Any) -> Any:
        """Return the policy's answer to the present observation."""
        seen = self._observation.now()
        action, seconds = timed(lambda: ask(seen))
        self._cell.log.compute("policy", seconds, 1.0 / self._settings.rate_hz)
        return action


POLICY = Method("a learned policy, which --policy names, on the encoders' readings", PolicyAgent, PolicySettings)
POLICY_CALIBRATED = Method(
    "a learned policy, which --policy names, above compensated cables", PolicyAgent, PolicySettings, calibrated=True
)
