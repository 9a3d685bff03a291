"""The clock of a cell at a console: paused, stepped, and standing while something is asked."""

from types import SimpleNamespace

import pytest
import trio

from trocar.console import Console
from trocar.robots import TICK_S
from trocar.view.wishes import Said, Wish

LONG_S, MANY = 0.5, 50


class Clock:
    """Ticks of a cell's clock, which wait for a console."""

    def __init__(self, **how):
        self.said = []
        self.console = Console(speed=0.0, hear=self._hear, **how)

    def _hear(self):
        said, self.said = self.said, []
        return said

    def ticks(self, *said):
        """Return how many ticks begin, up to ``MANY``, once the person has said this."""

        async def count():
            number = 0
            with trio.move_on_after(LONG_S):
                while number < MANY:
                    await self.console.wait(0.0)
                    await trio.sleep(0)
                    number += 1
            return number

        self.said = list(said)
        return trio.run(count)


def test_a_paused_clock_stands_until_it_is_to_run():
    clock = Clock()
    assert clock.ticks() == MANY
    assert clock.ticks(Said(Wish.PAUSE, value=True)) == 0
    assert clock.ticks(Said(Wish.PAUSE, value=False)) == MANY
    assert Clock(paused=True).ticks() == 0


@pytest.mark.parametrize("step_s", [0.1, 0.5])
def test_a_step_is_as_long_as_it_says(step_s):
    clock = Clock()
    assert clock.ticks(Said(Wish.STEP, value=step_s)) == round(step_s / TICK_S)
    assert clock.ticks() == 0, "it is paused afterwards"


def test_while_something_is_asked_no_step_is_made():
    """Else what the script does after the yes would differ from what it does alone."""
    clock = Clock()
    clock.console._question = SimpleNamespace()
    assert clock.ticks(Said(Wish.STEP, value=0.1)) == 0
    clock.console._question = None
    assert clock.ticks() == 10


def test_a_clock_that_is_ending_does_not_stand():
    over = []
    clock = Clock(paused=True, over=lambda: bool(over))
    assert clock.ticks() == 0
    over.append(True)
    assert clock.ticks() == MANY
