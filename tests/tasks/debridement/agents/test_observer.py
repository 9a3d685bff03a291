"""What is known about fragments that a pair of images does not show."""

import numpy as np
import pytest

from debridement_stage import Eyes, play
from trocar.geometry.capsules import Capsules
from trocar.tasks.debridement.agents.observer import FragmentMemory
from trocar.tasks.debridement.agents.raven_arm import RavenArm
from trocar.tasks.debridement.perception.fragments import SeenFragment

EYES = np.array([[0.0, 0.1, 0.25], [0.047, 0.1, 0.25]])
PLACE = np.array([0.0, 0.0, 0.004])


def fragment(place=PLACE, height_m=0.004):
    return SeenFragment(np.asarray(place), np.array([0.012, 0.009]), 0.3, height_m, 500)


def arm(shift_m=0.0):
    """Return four capsules; the fingers are on the way from the eyes to ``PLACE``, or so far beside it."""
    middle = 0.7 * PLACE + 0.3 * EYES.mean(axis=0) + [shift_m, 0.0, 0.0]
    away = np.array([0.3, 0.3, 0.3])
    ends = [[away, away], [away, away], [middle, middle + [0, 0, 0.01]], [middle, middle + [0, 0, 0.02]]]
    return Capsules(np.array(ends), np.full(4, 0.003))


@pytest.fixture
def memory():
    """A memory that has seen one fragment beside an arm."""
    made = FragmentMemory()
    assert [len(found) for found in made.update([fragment()], EYES, {"left": arm(0.2)})] == [1, 0]
    return made


def test_what_an_arm_hides_is_still_there(memory):
    shown, (hidden,) = memory.update([], EYES, {"left": arm()})
    assert not shown and np.allclose(hidden.p_world_m, PLACE)


def test_what_nothing_hides_has_gone(memory):
    assert memory.update([], EYES, {"left": arm(0.2)}) == ([], [])
    assert memory.update([], EYES, {"left": arm()}) == ([], [])  # and stays gone


def test_what_jaws_have_taken_is_not_remembered(memory):
    memory.take("left", PLACE)
    assert memory.update([], EYES, {"left": arm()}) == ([], [])


def test_what_jaws_have_shifted_before_they_took_it_is_not_remembered():
    memory, shifted = FragmentMemory(), PLACE + [0.007, -0.010, 0.0]
    memory.update([fragment(), fragment(PLACE + [0.06, 0.0, 0.0])], EYES, {"left": arm(0.2)})
    shown, hidden = memory.update([fragment(shifted), fragment(PLACE + [0.06, 0.0, 0.0])], EYES, {"left": arm()})
    assert (len(shown), len(hidden)) == (2, 0)  # the same one, not another beside it
    memory.take("left", PLACE)
    _, hidden = memory.update([fragment(PLACE + [0.06, 0.0, 0.0])], EYES, {"left": arm()})
    assert not hidden


def test_a_neighbour_that_was_known_takes_no_hidden_one_s_place():
    memory, beside = FragmentMemory(), PLACE + [0.013, 0.0, 0.0]
    memory.update([fragment(), fragment(beside)], EYES, {"left": arm(0.2)})
    shown, hidden = memory.update([fragment(beside)], EYES, {"left": arm()})
    assert (len(shown), len(hidden)) == (1, 1)


def test_what_is_seen_through_jaws_that_carry_is_what_they_carry():
    """A finger splits what it holds in the pictures, whose parts may match as something on the work surface."""
    memory = FragmentMemory()
    memory.take("left", PLACE + [0.05, 0.0, 0.0])
    assert memory.update([fragment()], EYES, {"left": arm(), "right": arm(0.2)}) == ([], [])
    memory.let_go("left")
    shown, _ = memory.update([fragment()], EYES, {"left": arm(), "right": arm(0.2)})
    assert len(shown) == 1


def test_what_hangs_in_the_air_is_not_remembered():
    memory = FragmentMemory()
    memory.update([fragment(height_m=0.03)], EYES, {"left": arm(0.2)})
    assert memory.update([], EYES, {"left": arm()}) == ([], [])


def test_jaws_that_lift_are_known_to_carry(monkeypatch, tmp_path):
    """The other arm may look meanwhile."""
    known, go = [], RavenArm.go

    async def lifts(self, T_world_goal, **how):
        if how.get("lift_m"):
            known.append(self.name in self.observer.memory._carrying)
        await go(self, T_world_goal, **how)

    monkeypatch.setattr(RavenArm, "go", lifts)
    play(monkeypatch, tmp_path, Eyes(), arms=1, fragments=1, budget_s=60.0)
    assert known == [True]
