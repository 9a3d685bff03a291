"""A person as a method of any task: ``trocar run TASK --method person --watch``."""

from __future__ import annotations

from trocar.cell import SEAT
from trocar.errors import InvalidInput
from trocar.eval.method import AgentContext, Method


class Person:
    """Lets the person at the console do the task with all working arms, until they say that it is done.

    Raises:
        InvalidInput: the cell has no console.
    """

    def __init__(self, context: AgentContext):
        self._context = context
        if SEAT not in context.cell.assistants:
            raise InvalidInput("a person's method", "has nobody at a console", "give --watch, and open its page")

    async def run(self) -> None:
        """Wait for the person."""
        await self._context.cell.assistants[SEAT].work(self._context.cell, self._context.arms)


PERSON = Method("a person at the console (--watch), on raw cables", Person, attended=True)
PERSON_CALIBRATED = Method(
    "a person at the console (--watch), above compensated cables", Person, calibrated=True, attended=True
)
