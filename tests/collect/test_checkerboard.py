"""A cell registered by a checkerboard through images, against the simulator's truth."""

from dataclasses import replace

import numpy as np
import pytest

from simulated import coarse
from trocar.collect.checkerboard import register_cell
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.lab import load_station

SEED, VIEWS = 4, 8


@pytest.fixture(scope="module")
def station():
    """The pair at half its resolution."""
    station = coarse(load_station("raven-pair"))
    return replace(station, registration=replace(station.registration, views=VIEWS))


@pytest.fixture(scope="module")
def found(station):
    calls = []
    registration = register_cell(
        station, np.random.SeedSequence(SEED), listener=lambda done, total: calls.append((done, total))
    )
    assert calls == [(k, VIEWS + 2) for k in range(1, VIEWS + 3)]
    return registration


@pytest.mark.slow
def test_lenses_and_boards_explain_their_corners(found):
    assert len(found.hand_px) > 0.7 * VIEWS
    assert found.calibration.rms_px < 0.5
    assert all(pose.rms_px < 0.5 for pose in found.poses.values())
    assert abs(found.calibration.rig.left.fx / 800 - 1) < 0.01


def test_what_is_left_of_the_brackets_errors_is_small(found, station):
    """The images see where the board really is: beside its place on the bracket, by what was drawn.

    Eight views leave the lens's middle uncertain by some pixels. That shifts all that is seen: both bases alike.
    """
    how = station.registration
    rng = np.random.default_rng(np.random.SeedSequence(SEED).spawn(3)[1])
    sd = np.repeat([how.bracket_sd_m, how.bracket_sd_rad], 3)
    base_off, T_world_camera = [], station.cameras[found.camera].T_world_camera
    for arm in station.arms:
        drawn = SE3.exp(sd * rng.standard_normal(6))
        T_board_found = how.T_world_board.inverse() @ T_world_camera @ found.poses[arm].T_left_board
        base_off.append((T_board_found @ drawn.inverse()).log())
    apart = base_off[0] - base_off[1]
    assert np.linalg.norm(apart[:3]) < 0.15e-3 and np.degrees(np.linalg.norm(apart[3:])) < 0.1


def test_the_first_base_is_the_worlds_reference_and_the_rest_is_near(found, station):
    np.testing.assert_allclose(found.T_world_base["left"].matrix, station.arm("left").T_world_base.matrix, atol=1e-12)
    off = found.errors()
    assert set(off["base_to_base"]) == {"right"}
    assert 0.05 < off["base_to_base"]["right"]["mm"] < 2.5 and off["base_to_base"]["right"]["deg"] < 0.7
    for arm in ("left", "right"):
        assert off["camera_to_base"][arm]["mm"] < 2.5 and off["camera_to_base"][arm]["deg"] < 0.7
        assert 0.02 < off["places_mm"][arm] < 1.5


def test_what_cannot_be_registered_so_is_refused(station):
    seeds = np.random.SeedSequence(0)
    with pytest.raises(TrocarError, match="station 'peg-transfer' is registered by points; give its"):
        register_cell(load_station("peg-transfer"), seeds)
    blind = replace(station, cameras=load_station("peg-transfer").cameras)
    with pytest.raises(TrocarError, match="has no stereo pair, which a checkerboard needs"):
        register_cell(blind, seeds)
