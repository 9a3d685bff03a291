"""Debridement as a task: its options, what it requires of a station, and what arms reach in its region."""

from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import ik
from trocar.errors import OutOfReach, TrocarError
from trocar.eval import TASKS
from trocar.eval.config import RunConfig
from trocar.geometry import SE3, SO3
from trocar.lab import load_station
from trocar.lab.session import draw_session
from trocar.tasks.debridement.agents.adjusted import INSIDE
from trocar.tasks.debridement.agents.places import TILT_RAD, TURNS_RAD
from trocar.tasks.debridement.goals import FragmentOutcome, Receptacle, Workspace
from trocar.tasks.debridement.scene import LENGTH_M
from trocar.tasks.debridement.task import REGION_M, Debridement

STATION = load_station("raven-pair")


@pytest.fixture
def station():
    return STATION


def test_it_is_registered():
    assert TASKS["debridement"] is Debridement


@pytest.mark.parametrize(("arms", "variant"), [(1, "one-arm"), (2, "two-arms")])
def test_one_arm_or_two_work(station, arms, variant):
    task = Debridement(arms=arms)
    assert task.variant == variant
    assert task.working_arms(task.at(station)) == ("left", "right")[:arms]
    assert RunConfig(task).about()["variant"] == variant


def test_there_is_one_goal_for_each_fragment(station):
    task = Debridement(fragments=3)
    assert [goal.number for goal in task.goals()] == [0, 1, 2]
    assert task.nominal().fragments == 3
    assert len(task.scene(np.random.default_rng(0), station).fragments) == 3


def test_the_referee_looks_from_both_eyes(station):
    eyes = Debridement().scene(np.random.default_rng(0), station).p_world_eyes_m
    assert np.linalg.norm(eyes[1] - eyes[0]) == pytest.approx(0.0468)
    assert eyes[0] == pytest.approx(station.cameras["stereo"].T_world_camera.translation_m)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"arms": 3}, "the number of arms is 3; give 1 or 2 with --arms"),
        ({"fragments": 0}, "the number of fragments is 0; give 1 to 12 with --fragments"),
        ({"fragments": 13}, "give 1 to 12"),
        ({"backdrop": "sea"}, "backdrop 'sea' is unknown; choose one of plain, tissue"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, sentence):
    with pytest.raises(TrocarError, match=sentence):
        Debridement(**options)


@pytest.mark.parametrize("fixture", ["table", "receptacle"])
def test_a_station_without_a_fixture_is_refused(station, fixture):
    fixtures = {name: T for name, T in station.T_world_fixture.items() if name != fixture}
    with pytest.raises(TrocarError, match=f"'raven-pair' has no fixture '{fixture}'"):
        Debridement().at(replace(station, T_world_fixture=fixtures))


def test_a_station_without_two_eyes_is_refused(station):
    with pytest.raises(TrocarError, match="has no camera 'stereo' with two eyes"):
        Debridement().at(replace(station, cameras={}))
    other = load_station("peg-transfer").cameras["overhead"]
    with pytest.raises(TrocarError, match="has no camera 'stereo' with two eyes"):
        Debridement().at(replace(station, cameras={"stereo": other}))


def test_two_arms_need_two_arms(station):
    alone = replace(station, arms={"left": station.arms["left"]})
    with pytest.raises(TrocarError, match="has one arm, and debridement --arms 2 needs two"):
        Debridement().at(alone)
    assert Debridement(arms=1).at(alone).arms == alone.arms


def test_an_arm_that_does_not_work_is_drawn_back_into_its_port(station):
    one, two = Debridement(arms=1).at(station), Debridement(arms=2).at(station)
    assert two.arms == station.arms and one.arms["left"] == station.arms["left"]
    lifted = one.arms["right"].park_q() - station.arms["right"].park_q()
    assert lifted.tolist() == pytest.approx([0, 0, 0.1, 0, 0, 0])


def test_the_nine_failure_modes_that_end_a_fragment_s_handling_have_a_sentence():
    names = {"NOT_FOUND", "GRASP_FAILURE", "MULTIPLE_GRASP", "PICKUP_FAILURE", "DROPPED_EN_ROUTE", "DROPOFF_FAILURE"}
    assert names <= set(FragmentOutcome.__members__)
    assert len({outcome.value for outcome in FragmentOutcome}) == len(FragmentOutcome)


# The work surface.


def test_what_lies_between_the_walls_is_in_the_receptacle():
    box = Receptacle()
    assert box.size_m == (0.110, 0.070), "that of the paper"
    x, y = 0.5 * np.array(box.size_m)
    inside = [[0, 0, 0.004], [x - 1e-4, y - 1e-4, 0.004], [0, 0, box.height_m - 1e-4]]
    outside = [[x + 1e-4, 0, 0.004], [0, -y - 1e-4, 0.004], [0, 0, box.height_m + 1e-4]]
    assert box.holds(np.array(inside)).all()
    assert not box.holds(np.array(outside)).any()


def test_fragments_lie_beside_the_receptacle_of_the_built_in_station():
    low, high = np.array(Workspace().region_m)
    assert (high - low > 0.04).all()
    edge = STATION.T_world_fixture["receptacle"].translation_m[1] - 0.5 * Receptacle().size_m[1] - Receptacle().wall_m
    assert high[1] + 0.5 * LENGTH_M[1] < edge
    middle = STATION.T_world_fixture["receptacle"].translation_m[0]
    assert 0.5 * (low[0] + high[0]) == pytest.approx(middle), "as far to one arm's side as to the other's"
    one_low, one_high = np.array(REGION_M[1])
    assert (one_low >= low).all() and (one_high <= high).all(), "the referee looks for fragments in the larger one"
    assert 0.5 * (one_low[0] + one_high[0]) > middle, "on the side of the arm that works"


# What arms reach there, as far as can be known before a session.

SESSIONS = [draw_session(STATION, np.random.default_rng(seed)) for seed in range(24)]
ABOVE_M, AT_M = -0.120, -0.150
"""Heights of the tip in the world, above a fragment and at it."""


def commanded(session, arm, T_world_tip):
    """The joints to be commanded so that the true ones bring the tip there."""
    model, cables, park = STATION.arms[arm].model, session.transmissions[arm], STATION.arms[arm].park_q()
    true = ik(model, session.T_world_base[arm].inverse() @ T_world_tip, reference=park)
    state, q = cables.start(park, np.random.default_rng(0)), true
    for _ in range(4):
        q = true - (cables.step(state, q)[0] - q)
        q = np.clip(q, model.lower, model.upper)
    return true - (cables.step(state, q)[0] - q)


def reaches(session, arm, x, y):
    model = STATION.arms[arm].model
    room = INSIDE * (model.upper - model.lower)
    for turn in TURNS_RAD:
        upright = SO3.axis("z", turn) @ SO3.axis("x", TILT_RAD)
        try:
            ways = [commanded(session, arm, SE3.from_parts(upright, [x, y, z])) for z in (AT_M, ABOVE_M)]
        except OutOfReach:
            continue
        if all(((model.lower + room < q) & (q < model.upper - room)).all() for q in ways):
            return True
    return False


@pytest.mark.parametrize(("arms", "sides"), [(1, ("left",)), (2, ("left", "right"))])
def test_a_working_arm_reaches_every_corner_in_nine_of_ten_sessions(arms, sides):
    (x0, y0), (x1, y1) = REGION_M[arms]
    for x in (x0, 0.5 * (x0 + x1), x1):
        for y in (y0, y1):
            share = np.mean([any(reaches(session, arm, x, y) for arm in sides) for session in SESSIONS])
            assert share >= 0.9, f"({1e3 * x:.0f}, {1e3 * y:.0f}) mm is reached in {share:.0%} of sessions"


def test_one_arm_does_not_reach_what_two_do():
    (x0, y0), _ = REGION_M[2]
    assert np.mean([reaches(session, "left", x0, y0) for session in SESSIONS]) < 0.9
