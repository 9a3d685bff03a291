"""The spheres that an instrument wears: where they are, and which colours tell them apart."""

import colorsys
from itertools import combinations

import numpy as np
import pytest

from trocar.arms import ARMS, frames
from trocar.errors import TrocarError
from trocar.perception.fiducials import COLORS, JAW, SHAFT, SIX_SPHERES, Fixture, Sphere

PSM = ARMS["psm-classic"]
JAW_SPHERES = np.flatnonzero(~SIX_SPHERES.on_shaft)


def test_the_printed_distances_are_those_of_the_paper():
    shaft = np.linalg.norm(SIX_SPHERES.centers_m[0] - SIX_SPHERES.centers_m[1])
    assert shaft == pytest.approx(0.035)
    assert SIX_SPHERES.centers_m[1, 2] == pytest.approx(0.0158)
    hub = np.array(SIX_SPHERES.hub_m)
    np.testing.assert_allclose(np.linalg.norm(SIX_SPHERES.centers_m[JAW_SPHERES] - hub, axis=-1), 0.035)
    np.testing.assert_allclose(2e3 * SIX_SPHERES.radii_m, [20, 17, 16, 16, 16, 16])


@pytest.mark.parametrize(
    ("spheres", "words"),
    [
        ((), "0 spheres on the shaft"),
        (SIX_SPHERES.spheres[:4], "2 spheres on the jaw; give 3"),
        (
            (*SIX_SPHERES.spheres, Sphere(JAW, "mauve", 0.008, (0, 0, 0))),
            "'mauve' is unknown; choose one of red, green",
        ),
    ],
)
def test_an_impossible_fixture_is_refused(spheres, words):
    with pytest.raises(TrocarError, match=words):
        Fixture(spheres, (0.0, 0.0, 0.0))


def test_one_sphere_on_the_shaft_and_three_on_the_jaw_are_a_fixture():
    made = Fixture(SIX_SPHERES.spheres[1:5], SIX_SPHERES.hub_m)
    assert made.on_shaft.tolist() == [True, False, False, False]
    assert 0.0 < made.arm_radius_m < made.radii_m.min() / 4, "its arms hide little"


def test_paints_are_colours_that_a_camera_tells_apart():
    """By 48 deg of hue or more; none reflects more light than falls on it."""
    hue = {}
    for name, rgb in COLORS.items():
        hue[name], saturation, value = colorsys.rgb_to_hsv(*rgb)
        assert saturation > 0.75 and 0.5 < value <= 1.0
    apart = [abs((360 * (hue[a] - hue[b]) + 180) % 360 - 180) for a, b in combinations(hue, 2)]
    assert min(apart) > 47.99


def test_spheres_of_one_colour_differ_in_size_or_part():
    kinds = [(sphere.part, sphere.color, sphere.radius_m) for sphere in SIX_SPHERES.spheres]
    assert len(set(kinds)) == 6 and {kind[0] for kind in kinds} == {SHAFT, JAW}


def test_the_cross_is_square_normal_to_the_jaws_and_just_ahead_of_them():
    centers, hub = SIX_SPHERES.centers_m[JAW_SPHERES], np.array(SIX_SPHERES.hub_m)
    np.testing.assert_allclose(centers[:, 1], hub[1])
    np.testing.assert_allclose(centers.mean(axis=0), hub, atol=1e-12)
    side = np.linalg.norm(centers - np.roll(centers, 1, axis=0), axis=1)
    np.testing.assert_allclose(side, 0.035 * np.sqrt(2.0))
    assert 1.5 * PSM.instrument.finger_length_m < hub[1] < 2.5 * PSM.instrument.finger_length_m


@pytest.mark.parametrize("name", ["psm-classic", "raven2-left"])
def test_spheres_move_with_the_shaft_and_with_the_jaw(name):
    arm = ARMS[name]
    q = arm.middle + [0.1, -0.1, 0.01, 0.5, 0.2, -0.3]
    found = SIX_SPHERES.base_centers_m(arm, np.stack([q, arm.middle]))
    assert found.shape == (2, 6, 3)
    wrist, jaw = frames(arm, q)[4], frames(arm, q)[6]
    up = arm.wrist_sign * wrist.rotation.matrix[:, 2]
    for number, sphere in enumerate(SIX_SPHERES.spheres):
        expected = wrist.translation_m + sphere.center_m[2] * up if number < 2 else jaw.apply(sphere.center_m)
        np.testing.assert_allclose(found[0, number], expected, atol=1e-12)
    distance = np.linalg.norm(found[0, :2] - frames(arm, q)[6].translation_m, axis=-1)
    assert distance[0] > distance[1] > 0.0158, "up the shaft, away from the jaw"
