"""A task that overrides nothing: an empty world in which every touch with some force counts."""

import mujoco
import numpy as np
import pytest

from trocar.sim.record import CollidingPair
from trocar.sim.world import TaskWorld, World


class Sleepy(TaskWorld):
    sleeps = True


def test_it_is_empty_and_counts_what_it_is_asked_about():
    task = TaskWorld()
    assert task.counts(CollidingPair("a", "arm", "b"), np.array([0.0, 0.0, 1.0])) is True
    assert task.collision(0, 1) is None and task.assistants() == {}
    record = object()
    assert task.truth(record) is record and task.arrays(record) == {}


@pytest.mark.parametrize(("task", "sleeps"), [(TaskWorld(), False), (Sleepy(), True)])
def test_bodies_that_lie_still_are_left_out_only_where_the_task_lets_them(task, sleeps):
    model = World({}, {}, task).model
    assert bool(model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP) == sleeps
