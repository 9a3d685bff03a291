"""What looks at the needle change of the way."""

from dataclasses import replace

import numpy as np
import pytest

from simulated import ideal_session
from trocar.arms import fk
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.motion import PLANNERS
from trocar.sim.laboratory import SimLaboratory
from trocar.station import load_station
from trocar.sutures.drive import drive
from trocar.sutures.primitive import grasp_pose
from trocar.tasks.kit import Brief
from trocar.tasks.suture.agents.circle import CircleSuturing, Settings, blind
from trocar.tasks.suture.agents.watch import Aim, stretches
from trocar.tasks.suture.score import score_sutures
from trocar.tasks.suture.task import CircleSutures

TASK = CircleSutures()
GOALS = TASK.goals()[:1]
STATION = TASK.at(load_station("suture"))
AWRY = SE3.exp([0.3e-3, 0.4e-3, -0.3e-3, 0.06, -0.05, 0.04])
"""How a person loads the needle, against what was agreed."""


def agent_in(lab, settings):
    return CircleSuturing(
        Brief(lab.cell, GOALS, None, ("psm1",), PLANNERS["spline"], None, np.random.default_rng(0), settings)
    )


def laboratory():
    scene, arm = TASK.scene(np.random.default_rng(0), STATION)
    world = TASK.world((replace(scene, T_needle_loaded=(AWRY,)), arm))
    return SimLaboratory(ideal_session(STATION), world, np.random.default_rng(0))


def driven(settings):
    lab = laboratory()
    agent = agent_in(lab, settings)
    assert lab.run(lambda cell: agent.run(), TASK.budget_s)
    (score,) = score_sutures(GOALS, lab.truth(), lab.log.events)
    return score, [event for event in lab.log.events if event["name"].startswith("needle")]


def test_a_needle_that_was_loaded_awry_goes_in_and_out_where_it_should():
    blindly, looks = driven(blind())
    assert max(blindly.entry_error_m, blindly.exit_error_m) > 1e-3 and looks == []
    score, looks = driven(Settings())
    assert score.succeeded
    assert max(score.entry_error_m, score.exit_error_m) < 0.7e-3
    assert sum(look["believed"] for look in looks) >= 4


def test_the_way_is_cut_where_the_needle_is_looked_at_and_stays_the_same():
    segments = drive(GOALS[0])
    found = stretches(segments, TASK.setup)
    assert [stretch.segment.name for stretch in found if stretch.first] == [segment.name for segment in segments]
    for segment in segments:
        parts = [stretch.segment for stretch in found if stretch.segment.name == segment.name]
        joined = np.concatenate([parts[0].q, *(part.q[1:] for part in parts[1:])])
        np.testing.assert_array_equal(joined, segment.q)
        assert sum(part.length_m for part in parts) == pytest.approx(segment.length_m)


def test_the_last_looks_come_just_before_the_needle_goes_in_and_comes_out():
    setup, segments = TASK.setup, drive(GOALS[0])
    entry, leaving = (stretch for stretch in stretches(segments, setup) if stretch.aim is Aim.TIP)
    assert (entry.segment.name, leaving.segment.name) == ("approach", "push 1")
    assert entry.segment.length_m == pytest.approx(2e-3, abs=0.3e-3)
    left = leaving.segment.length_m / setup.needle.radius_m
    turned = setup.insertion.rotation_rad + setup.insertion.regrasp_rad - left
    exit_rad = setup.insertion.exit_turn_rad(setup.needle.radius_m)
    assert np.degrees(exit_rad - turned) == pytest.approx(8.0, abs=1.5)


def test_the_camera_nearest_to_the_circle_is_used_and_a_cell_without_one_is_refused():
    lab = laboratory()
    used = agent_in(lab, Settings()).watch._camera
    assert used is lab.cell.cameras["close"]
    lab.cell = replace(lab.cell, cameras={})
    with pytest.raises(TrocarError, match="no camera of this cell shows depth, to look at the needle; choose --method"):
        agent_in(lab, Settings())


def test_the_needles_tip_is_aimed_at_where_it_should_be_by_what_is_believed_of_arm_and_grip():
    agent = agent_in(laboratory(), Settings())
    watch, arm = agent.watch, TASK.setup.arm
    watch.loaded(TASK.setup)
    entry = next(stretch for stretch in stretches(drive(GOALS[0]), TASK.setup) if stretch.aim is Aim.TIP)
    watch.aim(replace(entry, aim=Aim.POSE))
    watch._belief._mean[:] = np.tile([2e-4, -1e-4, 3e-4, 0.01, -0.02, 0.015], 3)
    watch.aim(entry)
    there = watch._belief.needle(fk(arm, watch.corrected(entry.segment).q[0])).T_base_needle
    planned = fk(arm, entry.segment.q[0]) @ grasp_pose(TASK.setup).inverse()
    tip = [0.0, -TASK.setup.needle.radius_m, 0.0]
    np.testing.assert_allclose(there.apply(tip), planned.apply(tip), atol=1e-7)


def test_without_a_look_the_way_is_the_planned_one():
    """Nothing is corrected before anything was seen."""
    agent = agent_in(laboratory(), Settings())
    agent.watch.loaded(TASK.setup)
    for stretch in stretches(drive(GOALS[0]), TASK.setup)[:1]:
        way = agent.watch.way(stretch)
        np.testing.assert_allclose(
            fk(TASK.setup.arm, way.q).matrix, fk(TASK.setup.arm, stretch.segment.q).matrix, atol=1e-9
        )
