"""The light on surfaces and the flaws of a sensor, against numbers by hand."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.lab import SensorFlaws
from trocar.sim.sensor import Light, _edges, _smooth_noise, apply_flaws, expose, shade

SURFACES = """<mujoco><asset><material name="blue" rgba=".1 .2 .6 1"/></asset><worldbody>
<geom name="green" size=".1" rgba=".2 .4 .1 1"/>
<geom name="metal" size=".1" rgba=".5 .45 .44 1"/>
<geom name="dark" size=".1" rgba=".38 .38 .38 1"/>
<geom name="tinted" size=".1" rgba=".5 .4 .3 1"/>
<geom name="painted" size=".1" material="blue"/>
<geom name="own" size=".1" material="blue" rgba=".2 .4 .1 1"/>
<geom name="grey" size=".1"/></worldbody></mujoco>"""
LIGHT = Light(ambient=0.06, gain=1.2, reference_m=0.6)
LAMP_M = (0.3, 0.0, 0.0)
TOWARDS = np.array([0.0, 0.0, -1.0])
HALF = np.array([0.6, 0.0, -1.8]) / np.sqrt(3.6)
"""Half-way between lamp and eye, from a point .4 m before the eye."""
QUIET = replace(SensorFlaws.none(), reference_m=0.5)
SIZE = (150, 160)


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(SURFACES)


def seen(model, name, normal=TOWARDS, lit=True, light=LIGHT):
    """Colour and mirroring of a point .4 m straight ahead; its lamp is .5 m away, at a cosine of .8."""
    geom = np.array([model.geom(name).id if name else -1], dtype=np.int32)
    rays, depth = np.array([[0.0, 0.0, 1.0]]), np.array([0.4 if name else np.nan])
    color, mirror = shade(model, rays, depth, geom, np.array([normal]), np.array([lit]), LAMP_M, light)
    return color[0], mirror[0]


def test_a_dull_surface_is_as_bright_as_its_distance_and_its_tilt_make_it(model):
    power = 0.8 * (0.6 / 0.5) ** 2
    albedo = np.array([0.2, 0.4, 0.1])
    assert_allclose(seen(model, "green")[0], albedo * 1.2 * (0.06 + power), rtol=1e-5)
    tilted = np.array([0.6, 0.0, -0.8])  # towards the lamp itself
    assert_allclose(seen(model, "green", tilted)[0], albedo * 1.2 * (0.06 + 1.44), rtol=1e-5)
    for ambient_alone in (seen(model, "green", lit=False), seen(model, "green", -TOWARDS)):
        assert_allclose(ambient_alone[0], albedo * 1.2 * 0.06, rtol=1e-5)
        assert ambient_alone[1] == 0.0
    bright = seen(model, "green", light=replace(LIGHT, gain=9.0))[0]
    assert bright.max() == 1.0, "it saturates"


def test_of_two_surfaces_one_behind_the_other_each_has_its_own_light(model):
    geom = np.array([0, 4], dtype=np.int32)
    rays, depth = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 1.0]]), np.array([0.4, 0.6])
    color, _ = shade(model, rays, depth, geom, np.array([TOWARDS, TOWARDS]), np.ones(2, bool), LAMP_M, LIGHT)
    assert_allclose(color[0], seen(model, "green")[0])
    assert_allclose(color[1], np.array([0.1, 0.2, 0.6]) * 1.2 * (0.06 + 1.0), rtol=1e-5)  # .6 m under the lamp


def test_bright_grey_metal_mirrors_the_lamp_and_nothing_else_does(model):
    color, mirror = seen(model, "metal", HALF)
    assert mirror == pytest.approx(1.0, abs=1e-5) and (color == 1.0).all()
    mirror_at_half = mirror
    color, mirror = seen(model, "metal")
    assert mirror == pytest.approx((1.8 / np.sqrt(3.6)) ** 80, rel=1e-3)
    assert_allclose(color, np.array([0.5, 0.45, 0.44]) * 1.2 * (0.06 + 1.152) + mirror, rtol=1e-5)
    assert seen(model, "metal", HALF, lit=False)[1] == 0.0, "not in the shadow"
    assert seen(model, "metal", HALF, light=replace(LIGHT, reference_m=0.2))[1] == mirror_at_half, "however weak"
    geom, rays = np.full(3, model.geom("metal").id, np.int32), np.tile([0.0, 0.0, 1.0], (3, 1))
    normals = np.array([HALF, TOWARDS, -TOWARDS])
    _, several = shade(model, rays, np.full(3, 0.4), geom, normals, np.ones(3, bool), LAMP_M, LIGHT)
    assert_allclose(several, [mirror_at_half, mirror, 0.0])
    for name in ("green", "dark", "tinted", "painted"):
        assert seen(model, name, HALF)[1] == 0.0, name


def test_a_material_colours_what_has_no_colour_of_its_own(model):
    share = 1.2 * (0.06 + 1.152)
    assert_allclose(seen(model, "painted")[0], np.minimum(np.array([0.1, 0.2, 0.6]) * share, 1), rtol=1e-5)
    assert_allclose(seen(model, "own")[0], np.array([0.2, 0.4, 0.1]) * share, rtol=1e-5)
    assert_allclose(seen(model, "grey", lit=False)[0], 0.5 * 1.2 * 0.06, rtol=1e-5)
    color, mirror = seen(model, "")
    assert not color.any() and mirror == 0.0


def delivered(flaws, depth=0.5, cosine=1.0, lit=True, mirror=0.0, color=0.25):
    """Depth and colour of a surface that is the same in every pixel, or as given pixel by pixel."""
    fields = (np.broadcast_to(np.asarray(value, np.float32), SIZE) for value in (cosine, lit, mirror))
    cosine, lit, mirror = fields
    color = np.full((*SIZE, 3), color, np.float32)
    depth = np.broadcast_to(np.asarray(depth, np.float64), SIZE)
    return apply_flaws(flaws, depth, color, cosine, lit > 0, mirror, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("depth", "cosine", "times"), [(0.5, 1.0, 1.0), (1.0, 1.0, 4.0), (0.5, 0.5, 2.0), (0.5, 0.05, 1 / 0.15)]
)
@pytest.mark.parametrize("kind", ["axial_m", "waviness_m"])
def test_depth_scatters_with_the_square_of_distance_and_with_the_tilt(depth, cosine, times, kind):
    found, _ = delivered(replace(QUIET, **{kind: 1e-3}, waviness_px=6.0), depth, cosine)
    assert np.std(found - depth) == pytest.approx(1e-3 * times, rel=0.03)
    assert np.isfinite(found).all()


def share_missing(flaws, **surface):
    return np.isnan(delivered(flaws, **surface)[0]).mean()


def test_as_many_pixels_lack_depth_as_should():
    assert share_missing(QUIET, cosine=0.01) == 0.0
    assert share_missing(replace(QUIET, missing=0.2)) == pytest.approx(0.2, abs=0.01)
    grazing = replace(QUIET, grazing_cos=0.2)  # likely from half as much again to half as much
    for cosine, share in ((0.31, 0.0), (0.25, 0.25), (0.2, 0.5), (0.15, 0.75), (0.09, 1.0)):
        assert share_missing(grazing, cosine=cosine) == pytest.approx(share, abs=0.01)
    assert share_missing(replace(QUIET, shadow=True), lit=False) == 1.0
    assert share_missing(replace(QUIET, shadow=True)) == share_missing(QUIET, lit=False) == 0.0
    shiny = replace(QUIET, specular_missing=0.8)
    for mirror, share in ((0.1, 0.0), (0.5, 0.3), (1.0, 0.7)):
        assert share_missing(shiny, mirror=mirror) == pytest.approx(share, abs=0.01)


def test_at_an_edge_depth_is_mixed_or_lost():
    column = np.arange(SIZE[1])
    low = column // 10 % 2 == 0  # stripes
    step = np.where(low, 0.5, 0.52)
    beside = (np.abs((column + 5) % 10 - 4.5) < 1) & (column > 0) & (column < SIZE[1] - 1)
    lost, _ = delivered(replace(QUIET, edge_missing=0.3), step)
    assert np.isnan(lost[:, beside]).mean() == pytest.approx(0.3, abs=0.03)
    assert np.isfinite(lost[:, ~beside]).all()
    mixed, _ = delivered(replace(QUIET, edge_mixed=0.6), step)
    assert np.isfinite(mixed).all() and (np.abs(mixed - step)[:, ~beside] < 1e-6).all()
    share = (mixed - 0.5) / 0.02
    assert share.min() > -1e-3 and share.max() < 1 + 1e-3, "between both depths"
    assert (np.abs(mixed - step)[:, beside] > 1e-6).mean() == pytest.approx(0.6, abs=0.03)
    assert share[:, beside & low].mean() == pytest.approx(0.3, abs=0.03)
    assert share[:, beside & ~low].mean() == pytest.approx(0.7, abs=0.03)
    both, _ = delivered(replace(QUIET, edge_mixed=0.5, edge_missing=0.5), step)
    assert (np.isnan(both) | (np.abs(both - step) > 1e-6))[:, beside].mean() > 0.95, "either, by one throw"


def test_colour_has_grain_that_grows_with_the_root_of_its_light():
    for color, sd in ((0.25, 0.8 * 4.0), (0.64, 1.1 * 4.0)):
        _, found = delivered(replace(QUIET, color_sd=4.0), color=color)
        assert found.mean() == pytest.approx(255 * color, abs=0.3)
        assert found.std() == pytest.approx(sd, rel=0.03)
        assert np.ptp(found.astype(int), axis=-1).max() <= 1, "the same in all channels"
    for color, level in ((1.3, 255), (-0.1, 0)):
        assert (delivered(QUIET, color=max(color, 0.0))[1] == level).all()


def test_a_jump_of_two_millimetres_is_an_edge_and_a_slope_is_none():
    rows, columns = np.meshgrid(np.arange(20.0), np.arange(30.0), indexing="ij")
    for jump_mm, found in ((1.3, False), (1.7, True)):
        for across, axis in ((rows > 7, 0), (columns > 11, 1)):
            depth = np.float32(0.5 + 1e-3 * (rows + 2 * columns) + 1e-3 * jump_mm * across)
            edge, other = _edges(depth)
            at = (8, 15) if axis == 0 else (9, 12)  # the first pixel beyond the jump, and the last before it
            back = tuple(np.array(at) - np.eye(2, dtype=int)[axis])
            assert edge[at] == edge[back] == found and edge.sum() == found * 2 * edge.shape[1 - axis]
            if found:
                assert other[at] == depth[back] and other[back] == depth[at], "what lies across it"
            assert (other[~edge] == depth[~edge]).all()


def test_smooth_noise_has_unit_variance_and_agrees_over_its_length():
    noise = _smooth_noise((120, 200), 10.0, np.random.default_rng(0))
    assert noise.shape == (120, 200) and noise.std() == pytest.approx(1.0, rel=1e-5)
    for axis in (0, 1):
        near, far = (np.mean(noise * np.roll(noise, by, axis)) for by in (2, 20))
        assert near > 0.8 and abs(far) < 0.3
    again = _smooth_noise((120, 200), 10.0, np.random.default_rng(0))
    assert (noise == again).all()
    coarser = _smooth_noise((120, 200), 40.0, np.random.default_rng(0))
    assert np.mean(coarser * np.roll(coarser, 10, 1)) > 0.7


def test_a_lens_makes_of_a_point_a_spot_of_more_than_half_a_pixel():
    point = np.zeros((21, 21, 3), np.float32)
    point[10, 10] = 1.0
    picture = expose(point, 0.0, np.random.default_rng(0))[..., 0].astype(float)
    spread = np.sum(picture * (np.arange(21) - 10.0) ** 2) / picture.sum()
    assert np.sqrt(spread) == pytest.approx(0.6, abs=0.05)
    assert picture.sum() == pytest.approx(255, abs=6)
    edge = np.ones((8, 8, 3), np.float32)
    assert (expose(edge, 0.0, np.random.default_rng(0)) == 255).all(), "borders stay as bright"
