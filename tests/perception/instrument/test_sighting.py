"""The wrist in a depth image of the simulated camera, flaws and all."""

from dataclasses import replace

import numpy as np
import pytest

from trocar.geometry import SE3
from trocar.perception.instrument import sight
from trocar.sim.camera import RayCamera
from trocar.sim.fiducial_cell import EmptyTable
from trocar.sim.mjcf import CellModel
from trocar.sim.sensor import Light
from trocar.sim.world import World
from trocar.station import load_station
from trocar.station.difficulty import Difficulty
from trocar.station.session import draw_session

STATION = replace(load_station("peg-transfer"), difficulty=Difficulty.of("recorded"))
OFF = np.array([0.08, -0.05, 0.06])
JAW_RAD = 0.9
SHIFT_SD_M = 0.25e-3
"""Of what errors of the outer joints do to an instrument, from look to look."""


@pytest.fixture(scope="module")
def seen():
    """Return what sees the arm in joints (6,) and its camera in the arm's base."""
    session = draw_session(STATION, np.random.default_rng(3))
    arm, T_world_base, camera = (
        session.models["psm1"],
        session.T_world_base["psm1"],
        session.station.cameras["overhead"],
    )
    T_world_camera = session.T_world_camera["overhead"]
    world = World(CellModel({"psm1": arm}, {"psm1": T_world_base}, EmptyTable()))
    eye = RayCamera(world.model, camera.model, T_world_camera, camera.lamp_m, camera.flaws, Light(gain=camera.gain))

    def look(q, rng):
        world.place_arm("psm1", q, JAW_RAD)
        return eye.render(world.data, rng)

    return look, arm, T_world_base.inverse() @ T_world_camera


def poses(arm, rng, count):
    q = np.tile(STATION.arm("psm1").park_q(), (count, 1))
    q[:, 3:] = rng.uniform([-1.0, -0.7, -0.9], [1.0, 0.7, -0.2], (count, 3))
    return q


def test_the_wrist_is_found_from_where_it_is_expected(seen):
    look, arm, T_base_camera = seen
    rng = np.random.default_rng(0)
    errors, scores = [], []
    for q in poses(arm, rng, 10):
        expected = q.copy()
        expected[3:] += OFF
        shift = SE3.from_parts(translation_m=rng.normal(0.0, SHIFT_SD_M, 3))
        found = sight(look(q, rng), shift @ T_base_camera, arm, expected, JAW_RAD)
        assert found is not None and found.points > 200 and found.left_m < 0.45e-3
        fixed = np.diag(np.repeat([1.0, 1.0 / SHIFT_SD_M**2], 3))
        covariance = np.linalg.inv(found.information + fixed)
        fitted = found.q[3:] + (covariance @ (found.pull - fixed @ np.append(np.zeros(3), found.shift_m)))[:3]
        errors.append(fitted - q[3:])
        scores.append(errors[-1] / np.sqrt(np.diag(covariance))[:3])
    assert (np.median(np.abs(errors), axis=0) < [0.06, 0.03, 0.05]).all(), "started .08 .05 .06 rad off"
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 2.0, "it says how sure it is"


def test_what_is_not_in_the_picture_is_not_seen(seen):
    look, arm, T_base_camera = seen
    q = STATION.arm("psm1").park_q()
    away = q.copy()
    away[0] += 0.3
    assert sight(look(away, np.random.default_rng(0)), T_base_camera, arm, q, JAW_RAD) is None
