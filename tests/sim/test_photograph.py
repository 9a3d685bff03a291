import numpy as np

from simulated import ideal_session, scene_of, standing
from trocar.sim.cell import SimulatedCell
from trocar.sim.photograph import Photographer


def test_a_picture_shows_another_state_and_leaves_the_world_alone():
    cell = SimulatedCell(ideal_session(), scene_of(standing(0)), np.random.default_rng(0))
    before = cell.world.data.qpos.copy()
    moved = before.copy()
    moved[cell.world.model.joint("block0").qposadr[0]] += 0.05
    first, again, other = (Photographer(cell.world).picture(state) for state in (before, before, moved))
    assert first.dtype == np.uint8 and first.ndim == 3
    assert first.std() > 10
    assert np.array_equal(first, again)
    assert (np.abs(first.astype(int) - other).max(axis=-1) > 30).sum() > 100
    assert np.array_equal(before, cell.world.data.qpos)
