"""Painted spheres on an instrument: where they hang, and how well they were printed."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import ARMS
from trocar.geometry import SE3
from trocar.perception.fiducials import COLORS, SIX_SPHERES
from trocar.sim.calibration_cells import printed
from trocar.sim.world import World


def test_a_printed_sphere_lies_beside_its_place_by_the_printers_scatter():
    rough = replace(SIX_SPHERES, print_sd_m=0.3e-3)
    rng = np.random.default_rng(0)
    off = np.array([printed(rough, rng).centers_m - rough.centers_m for _ in range(200)])
    assert_allclose(off.std(axis=(0, 1)), 0.3e-3, rtol=0.06)
    assert np.abs(off.mean(axis=0)).max() < 0.1e-3
    assert_allclose(printed(rough, rng).radii_m, rough.radii_m)


@pytest.mark.parametrize("name", ["psm-classic", "raven2-left"])
def test_spheres_hang_on_shaft_and_jaws_and_rods_lead_to_those_of_the_jaws(name):
    arm, fixture = ARMS[name], SIX_SPHERES
    world = World({"x": arm}, {"x": SE3.identity()}, fixtures={"x": fixture})
    model = world.model
    q = np.random.default_rng(0).uniform(arm.lower, arm.upper)
    world.place_arm("x", q, 0.0)
    assert_allclose(world.data.geom_xpos[world.geoms("x_sphere")], fixture.base_centers_m(arm, q), atol=1e-9)
    for number, sphere in enumerate(fixture.spheres):
        geom = model.geom(f"x_sphere{number}")
        assert geom.size[0] == sphere.radius_m
        assert_allclose(geom.rgba, [*COLORS[sphere.color], 1], rtol=1e-6)
    rods = world.geoms("x_rod")
    assert len(rods) == 4
    for rod, center in zip(rods, fixture.frame_centers_m(arm)[~fixture.on_shaft], strict=True):
        assert model.body(model.geom_bodyid[rod]).name == "x_link6"
        radius, half = model.geom_size[rod, :2]
        assert radius == fixture.arm_radius_m
        assert 2 * half == pytest.approx(np.linalg.norm(center - np.array(fixture.hub_m)))
        assert_allclose(model.geom_pos[rod], (center + fixture.hub_m) / 2, atol=1e-12)
        assert model.geom_rgba[rod][:3].max() < 0.05 and model.geom_rgba[rod][3] == 1, "black"
    assert (model.geom_contype[rods] > 0).all(), "rays miss what nothing collides with"
