"""How looks at the needle change the path."""

from dataclasses import replace

import numpy as np
import pytest

from sewing import briefed, sewing_laboratory
from simulated import coarse
from trocar.arms import fk
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.lab import load_station
from trocar.robots.arm_script import ArmScript
from trocar.tasks.suture.agents.circle import CircleSuturing, Settings, blind
from trocar.tasks.suture.agents.needle_estimator import DOUBT, NeedleEstimate
from trocar.tasks.suture.agents.needle_tracker import FINDING_LOOKS, Aim, stretches
from trocar.tasks.suture.planning.primitive import grasp_pose
from trocar.tasks.suture.planning.segments import suture_segments
from trocar.tasks.suture.score import score_sutures
from trocar.tasks.suture.task import CircleSutures

TASK = CircleSutures()
GOALS = TASK.goals()[:1]
STATION = coarse(TASK.at(load_station("suture")))
QUICK = {"driving_speed_m_s": 0.016}
"""Faster than the defaults, so that the tests are too."""
MISLOADED = SE3.exp([0.4e-3, 0.5e-3, -0.4e-3, 0.06, -0.05, 0.04])
"""How a person loads the needle, against what was agreed."""


def agent_in(lab, settings):
    return CircleSuturing(briefed(lab.cell, GOALS, settings))


def laboratory():
    scene, arm = TASK.scene(np.random.default_rng(0), STATION)
    return sewing_laboratory(TASK, STATION, (replace(scene, T_needle_loaded=(MISLOADED,)), arm), flawed=True)


def driven(settings):
    lab = laboratory()
    agent = agent_in(lab, settings)
    assert lab.run(lambda cell: agent.run(), TASK.budget_s)
    (score,) = score_sutures(GOALS, lab.truth(), lab.log.events)
    return score, [event for event in lab.log.events if event["name"].startswith("needle")]


@pytest.mark.slow
def test_a_needle_that_was_loaded_awry_goes_in_and_out_where_it_should():
    blindly, looks = driven(replace(blind(), **QUICK))
    assert max(blindly.entry_error_m, blindly.exit_error_m) > 1e-3 and looks == []
    score, looks = driven(Settings(**QUICK))
    assert score.succeeded
    assert max(score.entry_error_m, score.exit_error_m) < 0.7e-3
    assert sum(look["accepted"] for look in looks) >= 4


def test_the_way_is_cut_where_the_needle_is_looked_at_and_stays_the_same():
    segments = suture_segments(GOALS[0])
    found = stretches(segments, TASK.setup)
    assert [stretch.segment.name for stretch in found if stretch.first] == [segment.name for segment in segments]
    whole, cut = (
        np.concatenate([parts[0].q, *(part.q[1:] for part in parts[1:])])
        for parts in (segments, [stretch.segment for stretch in found])
    )
    np.testing.assert_array_equal(whole, cut)
    assert sum(stretch.segment.length_m for stretch in found) == pytest.approx(sum(s.length_m for s in segments))


def test_after_the_last_looks_the_needle_goes_through_the_surface_without_a_stop():
    setup, segments = TASK.setup, suture_segments(GOALS[0])
    tips = [stretch for stretch in stretches(segments, setup) if stretch.aim is Aim.TIP]
    assert [stretch.segment.name for stretch in tips] == ["penetrate", "penetrate", "push 1", "push 1"]
    assert [stretch.looks for stretch in tips] == [4, 0, 1, 3]
    entry, further, before, leaving = tips
    assert [stretch.fixed_wrist for stretch in tips] == [True, False, False, False]
    assert entry.segment.length_m == pytest.approx(2e-3 + 2.5e-3, abs=0.5e-3)  # the tip goes in on the way
    assert entry.segment.length_m + further.segment.length_m == pytest.approx(
        setup.insertion.straight_m + 2e-3, abs=3e-4
    )
    assert np.degrees(before.segment.length_m / setup.needle.radius_m) == pytest.approx(16.0 - 8.0, abs=1.0)
    turned = np.degrees(leaving.segment.length_m / setup.needle.radius_m)
    assert turned == pytest.approx(8.0 + 8.0, abs=1.0)  # from so far before the exit to so far past it


def test_the_camera_nearest_to_the_circle_is_used_and_a_cell_without_one_is_refused():
    lab = laboratory()
    used = agent_in(lab, Settings()).tracker.camera
    assert used is lab.cell.cameras["close"]
    lab.cell = replace(lab.cell, cameras={})
    with pytest.raises(TrocarError, match="no camera of this cell shows depth, to look at the needle; choose --method"):
        agent_in(lab, Settings())


def test_the_needles_tip_is_aimed_at_where_it_should_be_by_what_is_believed_of_arm_and_grip(monkeypatch):
    agent = agent_in(laboratory(), Settings())
    tracker, arm = agent.tracker, TASK.setup.arm
    tracker.loaded()
    entry = next(stretch for stretch in stretches(suture_segments(GOALS[0]), TASK.setup) if stretch.aim is Aim.TIP)
    monkeypatch.setattr(ArmScript, "q", property(lambda hand: entry.segment.q[0]))  # it is there
    tracker.estimator._mean[:] = np.tile([2e-4, -1e-4, 3e-4, 0.01, -0.02, 0.015], 2)
    tracker.aim(entry)
    corrected = tracker.corrected(entry.segment).q
    tip = [0.0, -TASK.setup.needle.radius_m, 0.0]
    for place in (0, -1):
        there = tracker.estimator.needle(fk(arm, corrected[place])).T_base_needle
        planned = fk(arm, entry.segment.q[place]) @ grasp_pose(TASK.setup).inverse()
        np.testing.assert_allclose(there.apply(tip), planned.apply(tip), atol=3e-5)
    np.testing.assert_array_equal(corrected[:, 3:], np.broadcast_to(agent.hand.q[3:], (len(corrected), 3)))
    turning = replace(entry, fixed_wrist=False)
    tracker.aim(turning)
    wrist = tracker.corrected(turning.segment).q[:, 3:]
    np.testing.assert_allclose(wrist[-1] - wrist[0], (entry.segment.q[-1] - entry.segment.q[0])[3:])
    assert np.abs(wrist[-1] - wrist[0]).max() > 1e-3


def test_what_is_left_of_a_correction_is_made_before_the_surface(monkeypatch):
    """The stretch after the last looks ends well past it; elsewhere, the arm joins the path towards its end."""
    agent = agent_in(laboratory(), Settings())
    tracker = agent.tracker
    tracker.loaded()
    found = stretches(suture_segments(GOALS[0]), TASK.setup)
    *_, leaving = (stretch for stretch in found if stretch.aim is Aim.TIP)
    off = np.array([2e-3, -1e-3, 2e-4, 0.01, -0.01, 0.01])
    monkeypatch.setattr(ArmScript, "q", property(lambda hand: leaving.segment.q[0] + off))
    tracker._aim, tracker._fixed_wrist = Aim.POSE, False
    for stretch, joined in ((leaving, 0.4), (replace(leaving, looks=1, aim=Aim.POSE), 1.0)):
        left = tracker.path(stretch).q - tracker.corrected(stretch.segment).q
        share = np.linspace(0.0, 1.0, len(left))
        np.testing.assert_allclose(left, np.maximum(1.0 - share / joined, 0.0)[:, None] * left[0], atol=1e-12)
        assert np.abs(left[0]).max() > 1e-3
    surface = np.radians(8.0) * TASK.setup.needle.radius_m / leaving.segment.length_m
    assert 0.4 < surface < 0.55


def test_between_looks_before_the_exit_the_tip_is_moved_by_the_outer_joints_alone(monkeypatch):
    """Also on the way to where the start is approached from, which is behind it."""
    lab = laboratory()
    agent = agent_in(lab, Settings())
    tracker = agent.tracker
    tracker.loaded()
    found = stretches(suture_segments(GOALS[0]), TASK.setup)
    *_, leaving = (stretch for stretch in found if stretch.aim is Aim.TIP)
    places = [leaving.segment.q[0]]

    async def looked():
        tracker.estimator._mean[:3] = [1e-3, 1e-3, 0.0]  # every time, the tip is found a millimetre off
        return False

    async def went(q):
        places.append(q)

    monkeypatch.setattr(ArmScript, "q", property(lambda hand: leaving.segment.q[0]))
    monkeypatch.setattr(tracker, "look", looked)
    monkeypatch.setattr(agent.hand, "go", went)
    assert lab.run(lambda cell: agent.look(leaving, tracker), 60.0)
    assert len(places) == 1 + 2 * leaving.looks
    np.testing.assert_array_equal(np.array(places)[:, 3:], np.tile(places[0][3:], (len(places), 1)))
    assert np.abs(np.array(places)[1:, :3] - places[0][:3]).max(1).min() > 1e-4


@pytest.mark.parametrize(("seen", "anew"), [(False, 2), (True, 0)])
def test_a_needle_that_is_not_seen_in_the_jaws_is_loaded_anew(seen, anew):
    lab = laboratory()
    agent = agent_in(lab, Settings())
    loadings = []

    async def load() -> bool:
        loadings.append(1)
        return True

    async def look(stretch, tracker):
        tracker.seen = seen

    agent._load, agent.look = load, look
    agent.tracker.loaded()
    approach = next(s for s in stretches(suture_segments(GOALS[0]), TASK.setup) if s.segment.name == "approach")

    async def script(cell):
        await agent.look(approach, agent.tracker)
        assert await agent.check_needle(0, approach, agent.tracker) is None

    lab.run(script, 10.0)
    assert len(loadings) == anew


def test_without_a_look_the_way_is_the_planned_one():
    """Nothing is corrected before anything was seen."""
    agent = agent_in(laboratory(), Settings())
    agent.tracker.loaded()
    for stretch in stretches(suture_segments(GOALS[0]), TASK.setup)[:1]:
        way = agent.tracker.path(stretch)
        np.testing.assert_allclose(
            fk(TASK.setup.arm, way.q).matrix, fk(TASK.setup.arm, stretch.segment.q).matrix, atol=1e-9
        )


def test_a_look_corrects_the_cameras_height_by_the_floor_it_shows():
    lab = laboratory()
    true = lab.cell.T_world_camera_registered["close"]
    off = SE3.from_parts(translation_m=[0.0, 0.0, 0.3e-3])
    lab.cell = replace(lab.cell, T_world_camera_registered=lab.cell.T_world_camera_registered | {"close": off @ true})
    tracker = agent_in(lab, Settings()).tracker
    tracker.rests(NeedleEstimate(TASK.setup.T_base_circle @ SE3.from_parts(translation_m=[0.0, 0.0, 0.02]), SURE))

    async def script(cell):
        await tracker.look()

    lab.run(script, 10.0)
    seen_from = TASK.setup.T_world_base @ tracker.T_base_camera
    np.testing.assert_allclose(seen_from.translation_m, true.translation_m, atol=0.03e-3)


SURE = np.diag(np.repeat([0.2e-3, 0.01], 3) ** 2)


def test_a_way_to_a_needle_that_rests_elsewhere_is_moved_with_it():
    tracker, way = agent_in(laboratory(), Settings()).tracker, suture_segments(GOALS[0])[1]
    planned = TASK.setup.T_base_circle @ SE3.from_parts(translation_m=[0.02, 0.0, 0.01])
    off = SE3.exp([0.5e-3, -0.4e-3, 0.3e-3, 0.05, -0.02, 0.03])
    tracker.rests(NeedleEstimate(planned @ off, SURE))
    moved = fk(TASK.setup.arm, tracker.towards_needle(way, planned).q)
    wanted = planned @ off @ planned.inverse() @ fk(TASK.setup.arm, way.q)
    np.testing.assert_allclose(moved.matrix, wanted.matrix, atol=1e-9)
    assert not tracker.seen


def test_a_needle_that_is_taken_lies_in_the_jaws_as_it_did_where_it_rested():
    agent = agent_in(laboratory(), Settings())
    tracker, q = agent.tracker, agent.hand.q
    off = SE3.exp([0.0, 0.2e-3, 0.0, 0.0, 0.0, 0.01])  # flat jaws would not straighten this
    resting = fk(TASK.setup.arm, q) @ grasp_pose(TASK.setup).inverse() @ off
    tracker.rests(NeedleEstimate(resting, SURE))
    tracker.took(TASK.setup)
    away = (resting.inverse() @ tracker.needle.T_base_needle).log()
    assert np.abs(away[:3]).max() < 0.3e-3 and np.abs(away[3:]).max() < 0.03
    way = tracker.with_needle(replace(suture_segments(GOALS[0])[1], q=np.repeat(q[None], 2, axis=0)))
    held = tracker.estimator.tip(fk(TASK.setup.arm, way.q[-1])) @ tracker.estimator.T_tip_needle
    planned = fk(TASK.setup.arm, q) @ grasp_pose(TASK.setup).inverse()
    np.testing.assert_allclose(held.matrix, planned.matrix, atol=1e-4)


@pytest.mark.parametrize(("seen_at", "looks"), [(1, 1), (2, 2), (9, FINDING_LOOKS)])
def test_a_needle_is_looked_for_less_certainly_each_time_until_it_is_seen(seen_at, looks):
    lab = laboratory()
    tracker = agent_in(lab, Settings()).tracker
    tracker.rests(NeedleEstimate(TASK.setup.T_base_circle, SURE))
    sureness, found = [], []

    async def look():
        sureness.append(tracker.needle.covariance[0, 0] / SURE[0, 0])
        tracker.seen = len(sureness) == seen_at
        return False

    tracker.look = look

    async def script(cell):
        found.append(await tracker.find())

    lab.run(script, 10.0)
    assert found == [looks == seen_at]
    np.testing.assert_allclose(sureness, DOUBT ** np.arange(looks))
