"""Distances from tissue, body wall and second arm agree with the instrument's solids."""

from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import ARMS, fk, frames
from trocar.arms.solids import capsules
from trocar.geometry import SE3
from trocar.tasks.suture.planning import DIRECTIONS, PRESETS, Suture, suture_joints, with_settings
from trocar.tasks.suture.planning.clearance import APART_M, JAW_OPEN_RAD, OFF_WALL_M, above_tissue_m, fingers_above_m
from trocar.tasks.suture.planning.primitive import jaws_above_m, path_samples

THETAS = np.radians(np.arange(0.0, 360.0, 30.0))


def drawn(arm, seed=0, count=40):
    """Return random joints (count, 6) of an arm, and a circle's pose in its base."""
    rng = np.random.default_rng(seed)
    return rng.uniform(arm.lower, arm.upper, (count, 6)), SE3.exp(rng.uniform(-1, 1, 6) * [0.1, 0.1, 0.1, 3, 3, 3])


def doubled(T_circle_tip):
    """Return poses (k,) as those of both directions (2, k)."""
    return SE3.unchecked(np.stack([T_circle_tip.matrix] * 2))


def above(arm, T_circle_tip, q, opened=False):
    """Return the least height along poses (k,) with joints (k, 6)."""
    return above_tissue_m(arm, doubled(T_circle_tip), np.array([opened] * len(q)), np.stack([q[None, :, 5]] * 2))[0, 0]


def lowest_corner(arm, T_base_circle, q, jaw_rad):
    """Return the height (k,) of the lowest corner of fingers with this opening, as if each turned its own last joint.

    In frame 6 the jaws point along y and turn about z, so that the finger on the side of -x opens with a positive turn.
    """
    found = np.full(len(q), np.inf)
    along, closing, axis = arm.instrument.finger_m(1).T
    for side in (-1, 1):
        T_circle_6 = T_base_circle.inverse() @ frames(arm, q - side * np.array([0, 0, 0, 0, 0, jaw_rad / 2]))[:, 6]
        for corner in np.stack([side * np.abs(closing), along, axis], -1):
            found = np.minimum(found, T_circle_6.apply(corner)[:, 2])
    return found


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_fingers_are_as_high_as_the_lowest_corner_of_their_solids_closed_and_open(arm):
    q, T_base_circle = drawn(arm)
    T_circle_tip = doubled(T_base_circle.inverse() @ fk(arm, q))
    closed, wide = (lowest_corner(arm, T_base_circle, q, jaw) for jaw in (0.0, JAW_OPEN_RAD))
    assert (wide < closed - 1e-3).any()
    opened = np.arange(len(q)) % 2 == 0
    found = fingers_above_m(arm, T_circle_tip, opened)
    np.testing.assert_allclose(found[0], np.where(opened, np.minimum(closed, wide), closed), atol=1e-12)


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_nothing_of_the_instrument_is_lower_than_it_says_where_the_shaft_rises(arm):
    """Capsules hold the solids, and end above or below what was assumed by no more than a radius."""
    q, T_base_circle = drawn(arm, 1, 400)
    T_circle_base = T_base_circle.inverse()
    T_circle_tip = T_circle_base @ fk(arm, q)
    solids = capsules(arm, q)
    ends = T_circle_base.apply(solids.ends_m.reshape(-1, 3)).reshape(len(q), 4, 2, 3)[..., 2]
    rises = ends[:, 0, 1] > ends[:, 0, 0]
    assert 50 < rises.sum() < 390
    heights = (ends - solids.radii_m[:, None]).min((1, 2))
    found = np.array([above(arm, T_circle_tip[k : k + 1], q[k : k + 1]) for k in range(len(q))])
    slack = max(solids.radii_m)
    assert np.abs(found - heights)[rises].max() <= slack
    at, shape = T_circle_base.apply(frames(arm, q).translation_m)[..., 2], arm.instrument
    balls = np.minimum(at[:, 5] - max(shape.shaft_radius_m, shape.wrist_radius_m), at[:, 6] - shape.knuckle_radius_m)
    fingers = fingers_above_m(arm, doubled(T_circle_tip), np.zeros(len(q), dtype=bool))[0]
    np.testing.assert_allclose(found, np.minimum(fingers, balls), atol=1e-12)


@pytest.mark.parametrize("name", PRESETS)
def test_along_sutures_it_is_the_least_of_all_samples_wherever_the_suture_is(name):
    setup = PRESETS[name].setup
    joints = suture_joints(setup, THETAS)
    arm = setup.arm
    T_circle_base = setup.T_base_circle.inverse()
    for row in (0, 1):
        for n in range(len(THETAS)):
            q = joints.q[row, n]
            both = zip(q, path_samples(setup).opened, strict=True)
            samples = [above(arm, (T_circle_base @ fk(arm, at))[None], at[None], opened) for at, opened in both]
            assert joints.above_tissue_m[row, n] == pytest.approx(min(samples), abs=1e-9)
    assert jaws_above_m(setup) >= joints.above_tissue_m.min() > 0


def test_a_suture_with_the_instrument_in_the_tissue_is_not_feasible():
    """On a flat circle nothing but the tissue forbids it: deeper, the same joints hold it."""
    joints = suture_joints(PRESETS["default"].setup, THETAS)
    sunk = replace(joints, above_tissue_m=joints.above_tissue_m - 0.0016)
    assert joints.feasible.any() and not sunk.feasible.any()
    grazing = replace(joints, above_tissue_m=np.zeros_like(joints.above_tissue_m))
    np.testing.assert_array_equal(grazing.feasible, joints.feasible)


def around(**settings):
    return with_settings(PRESETS["default"], settings).setup


def test_without_a_body_wall_and_a_second_port_nothing_is_in_the_way():
    joints = suture_joints(around(), THETAS)
    assert np.isposinf(joints.inside_wall_m).all() and np.isposinf(joints.arms_apart_m).all()


def test_under_a_flat_body_wall_its_height_over_the_highest_solid_is_what_is_left():
    """The wrist is highest: its capsule, which ends where the shaft begins."""
    setup = around(wall_up_mm=75)
    joints = suture_joints(setup, THETAS)
    solids = capsules(setup.arm, joints.q).moved(setup.T_world_base)
    highest = (solids.ends_m[..., 1, :, 2].max(-1) + solids.radii_m[1]).max(-1)
    radius_m = setup.arm.instrument.shaft_radius_m
    expected = 0.075 - OFF_WALL_M - highest - max(radius_m - solids.radii_m[1], 0.0)
    np.testing.assert_allclose(joints.inside_wall_m, expected, atol=1e-12)


def test_a_body_wall_that_is_turned_and_leans_with_the_base_leaves_as_much():
    leaning = {"wall_up_mm": 60, "wall_slope_deg": 25, "wall_thick_mm": 60}
    usual = suture_joints(around(**leaning, wall_azimuth_deg=30), THETAS).inside_wall_m
    turned = {"base_azimuth_deg": 225 + 60, "wall_azimuth_deg": 90}
    found = suture_joints(around(**leaning, **turned), THETAS + np.pi / 3).inside_wall_m
    assert np.ptp(usual) > 1e-3
    np.testing.assert_allclose(found, usual, atol=1e-12)


@pytest.mark.parametrize(("settings", "off_mm"), [({}, 10), ({"puller_up_mm": 92}, 18), ({"puller_up_mm": 155}, 15)])
def test_ports_lie_in_the_body_wall(settings, off_mm):
    joints = suture_joints(around(wall_up_mm=110, **settings), THETAS)
    np.testing.assert_allclose(joints.inside_wall_m.max(), -off_mm / 1e3, atol=1e-12)
    assert not joints.feasible.any()


def test_the_drive_unit_stays_outside_of_a_steep_body_wall():
    """Deep in the body, a shaft that passes the port at a slant has its drive unit near the outer surface."""
    slanted = around(base_sideways_mm=140, base_up_mm=60, base_tilt_deg=65, wall_up_mm=59.9, wall_thick_mm=0.2)
    thick = around(base_sideways_mm=140, base_up_mm=60, base_tilt_deg=65, wall_up_mm=59.9, wall_thick_mm=100)
    thin, nearer = (suture_joints(setup, THETAS).inside_wall_m for setup in (slanted, thick))
    assert (nearer < thin - 0.01).any() and (nearer <= thin + 1e-12).all()


def test_the_second_instrument_goes_straight_from_its_port_to_the_needles_tip():
    setup = around(puller_up_mm=100)
    joints = suture_joints(setup, THETAS)
    last = np.array([setup.insertion.straight_m]), np.array([setup.insertion.turn_rad])
    shares = np.linspace(0.0, 1.0, 2001)[:, None]
    for row, direction in enumerate(DIRECTIONS):
        for n, theta in enumerate(THETAS):
            tip = setup.circle.T_world_circle.apply(Suture(setup, float(theta), direction).needle_tip_m(*last)[0])
            second = setup.puller.port_m + shares * (tip - setup.puller.port_m)
            solids = capsules(setup.arm, joints.q[row, n, -1]).moved(setup.T_world_base)
            start, end = solids.ends_m[:, None, 0], solids.ends_m[:, None, 1]
            along = np.clip(((second - start) * (end - start)).sum(-1) / ((end - start) ** 2).sum(-1), 0.0, 1.0)
            apart = np.linalg.norm(second - start - along[..., None] * (end - start), axis=-1) - solids.radii_m[:, None]
            left = apart.min() - setup.arm.instrument.shaft_radius_m - APART_M
            assert joints.arms_apart_m[row, n] == pytest.approx(left, abs=2e-5)
    assert (joints.drivable & ~joints.feasible).any()
