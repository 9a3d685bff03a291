"""What is known about fragments that a pair of images does not show."""

from contextlib import nullcontext
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import trio

from debridement_stage import Eyes, play
from trocar.geometry import SE3
from trocar.geometry.capsules import Capsules
from trocar.lab import load_station
from trocar.perception.image import StereoImage
from trocar.tasks.debridement.agents.observer import FROZEN, CameraFrozen, FragmentMemory, StereoObserver
from trocar.tasks.debridement.agents.raven_arm import RavenArm
from trocar.tasks.debridement.agents.settings import best
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


@pytest.mark.parametrize(("past_m", "hides"), [(0.0165, 1), (0.0175, 0), (-0.0165, 1), (-0.0175, 0)])
def test_an_arm_hides_what_it_passes_by_half_its_length_and_some_millimetres(memory, past_m, hides):
    """A finger 6 mm thick, 8 mm round it, and half of a fragment of 12 mm."""
    aside_m = past_m - 0.3 * EYES[:, 0].mean()  # one eye looks straight along x = 0
    assert [len(found) for found in memory.update([], EYES[[0, 0]], {"left": arm(aside_m)})] == [0, hides]


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


def test_what_was_taken_is_forgotten_at_both_places_if_it_was_seen_as_two(memory):
    beside = PLACE + [0.008, 0.0, 0.0]
    memory.update([fragment(), fragment(beside)], EYES, {"left": arm(0.2)})
    memory.take("right", PLACE + [0.001, 0.0, 0.0])
    assert memory.update([], EYES, {"left": arm(), "right": arm(0.2)}).hidden == []


def test_a_neighbour_of_what_was_taken_is_still_there_behind_the_arm(memory):
    memory.update([fragment(), fragment(PLACE + [0.013, 0.0, 0.0])], EYES, {"left": arm(0.2)})
    memory.take("right", PLACE + [0.012, 0.0, 0.0])
    _, (hidden,) = memory.update([], EYES, {"left": arm(), "right": arm(0.2)})
    assert np.allclose(hidden.p_world_m, PLACE)


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


@pytest.mark.parametrize(("height_m", "remembered"), [(0.009, 1), (0.014, 0)])
def test_what_hangs_in_the_air_is_not_remembered(height_m, remembered):
    """Fragments are 8 to 12 mm high."""
    memory = FragmentMemory()
    memory.update([fragment(height_m=height_m)], EYES, {"left": arm(0.2)})
    assert [len(found) for found in memory.update([], EYES, {"left": arm()})] == [0, remembered]


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


# Images that are new, and those of a camera that has stopped.

RIG = load_station("raven-pair").cameras["stereo"].model
PICTURES = [np.full((RIG.left.height, RIG.left.width, 3), shade, np.uint8) for shade in (10, 20)]


def observer_of(pictures, tips_m, age_s=0.0):
    """Return an observer, and its camera, which gives these pictures while the tips of two arms are at these places."""

    class Camera:
        model, taken = RIG, 0

        def __init__(self):
            self.windows = []

        async def capture(self, window):
            self.taken += 1
            picture = PICTURES[pictures[self.taken - 1]]
            return StereoImage(picture, picture, RIG, 0.1 * self.taken)

    async def compute(arm, what, find, budget_s):
        return find()

    async def sleep(_):
        pass

    camera, arms = Camera(), ("left", "right")
    robot = SimpleNamespace(
        age_s=lambda _: age_s,
        T_world_tip=lambda _: SE3.identity(),
        kinematic=lambda name: SE3.from_parts(translation_m=tips_m[camera.taken - 1][arms.index(name)]),
    )
    cell = SimpleNamespace(
        cameras={"stereo": camera},
        T_world_camera_registered={"stereo": SE3.identity()},
        arms=dict.fromkeys(arms),
        log=SimpleNamespace(span=lambda *_: nullcontext()),
        clock=SimpleNamespace(sleep=sleep),
        compute=compute,
    )
    perception = SimpleNamespace(gripper=lambda *_: None, gripper_window=lambda *_, **how: camera.windows.append(how))
    return StereoObserver(cell, perception, robot, best()), camera


STILL, MOVED = np.zeros((2, 3)), np.array([[0.0, 0.0, 0.0], [0.0, 0.005, 0.0]])
"""One of two arms moves, along one axis."""


def test_a_camera_that_shows_the_same_although_an_arm_has_moved_is_frozen():
    observer, camera = observer_of([0] * 9, [STILL, *[MOVED] * 8])
    trio.run(observer.track, "left")
    with pytest.raises(CameraFrozen, match="check its connection"):
        trio.run(observer.track, "left")
    assert camera.taken == 1 + FROZEN


def test_a_camera_that_shows_the_same_while_all_arms_rest_is_not():
    observer, camera = observer_of([0, 0], [STILL, STILL])
    for _ in range(2):
        trio.run(observer.track, "left")
    assert camera.taken == 2


def test_an_old_image_is_taken_again_and_another_arm_s_is_not_compared():
    observer = observer_of([0, 0, 0, 1], [STILL, *[MOVED] * 3])[0]
    assert trio.run(observer.track, "left")[0].time_s == pytest.approx(0.1)
    assert trio.run(observer.track, "right")[0].time_s == pytest.approx(0.2), "the first of its own"
    assert trio.run(observer.track, "left")[0].time_s == pytest.approx(0.4), "the first that is new"


@pytest.mark.parametrize(
    ("age_s", "given_m", "margin_m"), [(0.9, 0.016, 0.016), (1.1, 0.016, 0.020), (1.1, 0.03, 0.03)]
)
def test_a_gripper_that_was_not_seen_for_a_second_is_looked_for_more_widely(age_s, given_m, margin_m):
    observer, camera = observer_of([0], [STILL], age_s)
    trio.run(partial(observer.track, "left", margin_m=given_m))
    assert camera.windows == [{"margin_m": margin_m, "binning": 1}]


def test_a_fragment_is_outlined_by_its_extents_about_its_middle():
    rim_m = fragment().rim_m
    assert np.allclose(rim_m.mean(0), PLACE)
    sides = np.diff(rim_m, axis=0)
    assert np.allclose(np.linalg.norm(sides, axis=1), [0.009, 0.012, 0.009])
    assert np.allclose(np.abs(sides[1] @ [np.cos(0.3), np.sin(0.3), 0.0]), 0.012)
