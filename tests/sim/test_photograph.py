"""Pictures of a trial for people, from its replay."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from simulated import ideal_laboratory, standing, trial_of
from trocar.geometry import SE3
from trocar.replay import Viewpoint
from trocar.sim.camera import RayCamera
from trocar.sim.framing import WIDTH, framed
from trocar.sim.photograph import Photographer
from trocar.station import SensorFlaws

VIEW = Viewpoint((0.13, -0.46, 0.33))
FRAME_M = np.array([[x, y, z] for x in (-0.07, 0.07) for y in (-0.05, 0.05) for z in (0.0, 0.05)])
"""The board, and as much above it as blocks are carried."""
SCALE = 0.5


@pytest.fixture(scope="module")
def lab():
    lab = ideal_laboratory(standing(0), standing(4, (1e-3, 0.0), 0.3))

    async def script(cell):
        await cell.clock.sleep(0.1)

    assert lab.run(script, 1.0)
    return lab


@pytest.fixture(scope="module")
def replay(lab):
    """The laboratory's replay, in which the first block has jumped by 5 cm at the end."""
    replay = trial_of(lab).replay()
    poses = replay.T_world_body["block0"].matrix.copy()
    poses[-1, 0, 3] += 0.05
    return replace(replay, T_world_body={**replay.T_world_body, "block0": SE3(poses)})


def changed(first, second):
    """Return how many pixels are of another colour."""
    return int((np.abs(first.astype(int) - second).max(axis=-1) > 30).sum())


def test_a_picture_shows_the_moment_it_was_asked_for_and_leaves_the_replay_alone(replay):
    before = {name: T.matrix.copy() for name, T in replay.T_world_body.items()}
    photographer = Photographer(replay, VIEW, scale=SCALE, frame_m=FRAME_M)
    first, end, again = (photographer.picture(t) for t in (0.0, replay.times_s[-1], 0.0))
    assert first.dtype == np.uint8 and first.shape[1:] == (WIDTH * SCALE, 3)
    assert first.std() > 10
    assert np.array_equal(first, again)
    assert changed(first, end) > 100
    assert np.array_equal(first, photographer.picture(0.004)), "the nearest moment"
    for name, T in replay.T_world_body.items():
        assert np.array_equal(T.matrix, before[name])


def test_every_solid_is_where_the_simulator_had_it(lab, replay):
    """Depth, ray by ray, in the world that was simulated and in the one that is drawn: table and planes apart."""
    framing = framed(np.array(VIEW.eye_m), FRAME_M, SCALE)
    photographer = Photographer(replay, VIEW, frame_m=FRAME_M)
    photographer.picture(0.0)
    mujoco.mj_forward(lab.world.model, lab.world.data)
    seen = []
    for model, data in ((lab.world.model, lab.world.data), (photographer._model, photographer._data)):
        camera = RayCamera(model, framing.lens, framing.T_world_camera, (0.12, 0.0, 0.0), SensorFlaws.none())
        depth, geom, _ = camera.render_exact(data)
        plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
        seen.append(np.where(plane | (geom < 0), np.nan, depth))
    simulated, drawn = seen
    assert np.isfinite(simulated).mean() > 0.2
    solid = np.isfinite(simulated) & np.isfinite(drawn)
    assert (np.isfinite(simulated) == np.isfinite(drawn)).mean() > 0.999
    assert np.quantile(np.abs(simulated - drawn)[solid], 0.999) < 20e-6


def test_bodies_may_have_other_colours_in_pictures(replay):
    plain = Photographer(replay, VIEW, scale=SCALE, frame_m=FRAME_M).picture(0.0)
    blue = Photographer(replay, VIEW, {"block": (0.0, 0.2, 1.0)}, SCALE, FRAME_M).picture(0.0)
    assert changed(plain, blue) > 100
    assert (
        (blue[..., 2].astype(int) - blue[..., 0] > 60).sum()
        > 50
        > (plain[..., 2].astype(int) - plain[..., 0] > 60).sum()
    )


def test_without_a_viewpoint_all_that_moved_is_in_the_picture(replay):
    first, end = (Photographer(replay, scale=SCALE).picture(t) for t in (0.0, replay.times_s[-1]))
    assert first.std() > 5
    assert changed(first, end) > 20
