"""A map of setups holds circles that can really be sewn all round, and no larger ones can."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import ARMS, fk
from trocar.tasks.suture.needle import NEEDLES
from trocar.tasks.suture.planning import SutureSetup, suture_joints
from trocar.tasks.suture.planning.primitive import jaws_above_m
from trocar.tasks.suture.planning.setup import Puller, Wall
from trocar.tasks.suture.planning.setup_map import RADII_M, _aimed, grasps, setup_map

PSM, RAVEN = ARMS["psm-classic"], ARMS["raven2-left"]
THETAS = np.radians(np.arange(0, 360, 5))


def all_round(setup):
    return suture_joints(setup, THETAS).feasible.any(0).all()


@pytest.fixture(scope="module")
def far():
    """Return the map of places at the edge of the PSM's reach."""
    done = []
    found = setup_map(
        PSM, NEEDLES["SH"], np.array([0.105, 0.120]), np.array([0.200]), progress=lambda *now: done.append(now)
    )
    assert done == [(1, 2), (2, 2)]
    return found


@pytest.mark.slow
def test_circles_can_be_sewn_all_round_from_where_the_base_stands(far):
    assert far.radius_m.tolist() == [[pytest.approx(0.035), 0.0]]
    (setup,) = far.setups.values()
    assert setup is far.best and all_round(setup)
    place = setup.T_base_circle.inverse().translation_m
    assert np.hypot(*place[:2]) == pytest.approx(0.105) and place[2] == pytest.approx(0.200)
    assert setup.grasp.holdable and jaws_above_m(setup) >= 0 and setup.comes_out


@pytest.mark.slow
def test_no_larger_circle_can_be_sewn_from_there(far):
    bases = _aimed(PSM, np.array([0.105, 0.0, 0.200]))
    for base, grasped in itertools.product(bases, grasps(PSM, NEEDLES["SH"])):
        circle = replace(grasped.circle, radius_m=0.040)
        assert not all_round(replace(grasped, T_world_base=base, circle=circle))
    assert any(abs(radius - 0.040) < 1e-9 for radius in RADII_M)


@pytest.mark.parametrize("arm", [PSM, RAVEN], ids=["psm", "raven"])
@pytest.mark.parametrize("place_m", [(0.05, 0.0, 0.1), (0.0, 0.0, 0.1), (-0.02, 0.03, -0.1)])
def test_resting_instruments_point_at_the_circles_centre(arm, place_m):
    resting = fk(arm, arm.middle).translation_m
    bases = _aimed(arm, np.array(place_m))
    for base in bases:
        tip = base.apply(resting) - place_m
        np.testing.assert_allclose(np.cross(tip, place_m), 0.0, atol=1e-12)
        assert np.dot(tip, place_m) < 0
    turns = [(bases[0].inverse() @ base).rotation.log() for base in bases[1:]]
    assert len({round(float(np.linalg.norm(turn)), 6) for turn in turns}) == 4, "45, 90, 135 and 180 deg, both ways"


def test_grasps_fit_the_needle_scale_the_primitive_and_bring_the_tip_out():
    usual = SutureSetup()
    for name, needle in NEEDLES.items():
        for setup in grasps(PSM, needle):
            assert setup.needle == needle and setup.comes_out and setup.grasp.holdable
            assert jaws_above_m(setup) >= 0
            assert setup.bite_m / needle.radius_m == pytest.approx(usual.bite_m / usual.needle.radius_m)
            last = setup.grasp.behind_tip_rad + setup.insertion.pushes * setup.insertion.regrasp_rad
            assert last <= needle.arc_rad, name
    assert len(list(grasps(PSM, NEEDLES["SH"]))) > 5
    assert not list(grasps(PSM, NEEDLES["PS-2"])), "3/8 of a circle is too short to be held above the tissue"


def test_without_a_grasp_nothing_can_be_sewn():
    found = setup_map(PSM, NEEDLES["PS-2"], np.array([0.05]), np.array([0.1]))
    assert found.radius_m.tolist() == [[0.0]] and found.best is None


def test_nothing_is_sewn_from_places_outside_of_the_body_wall_and_less_with_a_second_arm_in_the_way():
    above = setup_map(PSM, NEEDLES["SH"], np.array([0.05]), np.array([0.10]), wall=Wall(0.06, 0.03))
    assert not above.setups
    inside = setup_map(PSM, NEEDLES["SH"], np.array([0.05]), np.array([0.10]), wall=Wall(0.085, 0.03))
    blocked = setup_map(PSM, NEEDLES["SH"], np.array([0.05]), np.array([0.10]), puller=Puller(0.0, 0.05, 0.1))
    assert inside.best.wall.up_m == 0.085 and inside.radius_m.max() == RADII_M.max() and not blocked.setups
