"""What a policy would observe, noted beside a script and in an environment, against what truly lies there."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from trocar.errors import InvalidInput
from trocar.eval.config import RunConfig
from trocar.eval.method import make_task
from trocar.eval.objects import WatchedObjects
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.eval.task import TASKS
from trocar.learn.environment import CellEnv
from trocar.learn.episode import OBJECTS, STATE, episode_of
from trocar.learn.poses import vectors
from trocar.registry import load_plugin
from trocar.tasks.debridement.perception.fragments import SeenFragment
from trocar.tasks.peg_transfer.shapes import Pegboard

SLACK_M = 1e-3


def yaw(pose):
    """Three times the yaw of a pose x, y, z and quaternion w, x, y, z, as cosine and sine."""
    w, x, y, z = pose[3:7]
    angle = 3 * np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return np.array([np.cos(angle), np.sin(angle)])


def still(env):
    """Return the action that leaves an environment's arms where they are."""
    return np.clip(env._control.observe()["joints"], env.action_space.low, env.action_space.high)


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    task = make_task(TASKS["peg-transfer"], ["transfers=1"])
    config = RunConfig(task, method="best", calibration="joints", seed=5, observations=True)
    return run_trial(config, prepare(config, 0, tmp_path_factory.mktemp("session")), 0)


def test_thirty_observations_a_second_are_kept_with_a_trial(trial):
    rows = trial.arrays["observed_state"]
    assert len(rows) == pytest.approx(30 * trial.duration_s, abs=2) and rows.shape[1] == 8


def test_joints_are_those_that_the_model_of_the_cables_estimates(trial):
    arm = trial.about["arms"][0]
    ticks = [int(k / 30 / 0.01 + 1e-6) for k in range(len(trial.arrays["observed_state"]))]

    def off_m(kind, T_world_base):
        rows = trial.arrays[f"{kind}_{arm}"][ticks].astype(float)
        poses = vectors(trial.scenery.arms[arm], T_world_base[arm], rows)
        return np.linalg.norm(poses[:, :3] - trial.arrays["observed_state"][:, :3], axis=1).mean()

    assert off_m("true", trial.scenery.T_world_base) < off_m("measured", trial.scenery.T_world_base_registered) - 5e-4


@pytest.mark.slow
def test_noise_in_the_commands_is_in_what_is_observed(tmp_path):
    """Demonstrations show how to come back to a path, if states say how far off it the arm is."""
    task = make_task(TASKS["peg-transfer"], ["transfers=1"])
    noisy = RunConfig(task, method="best", calibration="joints", seed=5, observations=True, command_noise=4.0)
    trial = run_trial(noisy, prepare(noisy, 0, tmp_path), 0)
    arm, seen = trial.about["arms"][0], trial.arrays["observed_state"][:, :3]
    ticks = [int(k / 30 / 0.01 + 1e-6) for k in range(len(seen))]

    def off_m(kind, bases):
        poses = vectors(trial.scenery.arms[arm], bases[arm], trial.arrays[f"{kind}_{arm}"][ticks].astype(float))
        return np.linalg.norm(poses[:, :3] - seen, axis=1)

    assert off_m("desired", trial.scenery.T_world_base_registered).max() > 4e-3, "it was pushed"
    assert off_m("true", trial.scenery.T_world_base).mean() < 1.2e-3


def test_blocks_are_where_they_truly_lie_once_they_were_seen(trial):
    rows, block = trial.arrays["observed_objects"], trial.arrays["body_block1"]
    assert_allclose(rows[0, 3:5], 0.0)
    assert_allclose(rows[0, :2], block[0, :2], atol=8e-3)
    seen = rows[30]
    assert_allclose(seen[:3], block[0, :3], atol=SLACK_M)
    assert seen[3:5] @ yaw(block[0]) > np.cos(3 * np.radians(3))
    assert rows[0, 14] == 0 and rows[-1, 14] == 1, "done once the block was seen on its target"
    board = trial.arrays["T_world_board"]
    assert_allclose(seen[11:14], board[:3, :3] @ Pegboard().pegs_m[7] + board[:3, 3], atol=SLACK_M)


def test_an_episode_shows_what_was_observed_unless_raw_commands_are_asked_for(trial):
    episode = episode_of(trial)
    frames = np.minimum(np.arange(episode.frames), len(trial.arrays["observed_state"]) - 1)
    assert_allclose(episode.columns[STATE], trial.arrays["observed_state"][frames])
    assert_allclose(episode.columns[OBJECTS], trial.arrays["observed_objects"][frames])
    assert episode.names[OBJECTS][:3] == [f"transfer1.block.position.{axis}" for axis in "xyz"]
    raw = episode_of(trial, commanded=True)
    assert np.abs(raw.columns[STATE] - episode.columns[STATE])[:, :3].max() > 5e-4
    assert_allclose(raw.columns[OBJECTS], episode.columns[OBJECTS])


def test_an_environment_sees_what_a_trial_sees():
    env = CellEnv("peg-transfer", transfers=1, observation=("objects", "privileged"), budget_s=3.0, seed=5)
    seen, _ = env.reset(options={"session": 0, "trial": 0})
    names = env.observation_names["objects"]
    assert names[3] == "transfer1.block.cos_3yaw" and seen["objects"][3] == 0
    action = still(env)
    for _ in range(45):
        seen = env.step(action)[0]
    true = seen["privileged"][7:14][[0, 1, 2, 6, 3, 4, 5]]
    assert_allclose(seen["objects"][:3], true[:3], atol=SLACK_M)
    assert seen["objects"][3:5] @ yaw(true) > np.cos(3 * np.radians(3))
    env.close()


def test_fragments_keep_their_numbers_and_are_where_they_truly_lie():
    env = CellEnv("debridement", observation=("objects", "privileged"), budget_s=3.0, fragments=4)
    seen, _ = env.reset(seed=2)
    assert not seen["objects"].any(), "nothing has been seen yet"
    action, first = still(env), None
    for step in range(80):
        seen = env.step(action)[0]
        first = seen["objects"] if step == 40 else first
    found, true = (rows.reshape(4, -1) for rows in (seen["objects"], seen["privileged"]))
    assert found[:, 5].all() and np.abs(found - first.reshape(4, -1))[:, :3].max() < SLACK_M
    off = np.linalg.norm(found[:, None, :2] - true[None, :, :2], axis=-1)
    assert sorted(off.argmin(axis=1)) == [0, 1, 2, 3] and off.min(axis=1).max() < 4e-3, "the camera's pose errs"
    env.close()


def test_a_fragment_that_was_carried_away_is_known_where_it_lies_now():
    env = CellEnv("debridement", observation="objects", budget_s=3.0, fragments=3)
    objects = env._observation.objects
    assert objects is not None
    one = SeenFragment(np.zeros(3), np.array([8e-3, 4e-3]), 0.0, 2e-3, 50)
    lying = [replace(one, p_world_m=np.array([x, 0.0, 0.0])) for x in (-0.04, 0.0, 0.04)]
    carried = replace(one, p_world_m=np.array([0.0, 0.06, 0.0]))
    objects.take(lying)
    objects.take([lying[0], lying[2]])
    assert_array_equal(objects.values.reshape(3, -1)[:, 5], [1, 0, 1], "held, or hidden")
    objects.take([lying[0], lying[2], carried])
    found = objects.values.reshape(3, -1)
    assert_allclose(found[:, :2], [[-0.04, 0.0], [0.0, 0.06], [0.04, 0.0]])
    assert found[:, 5].all()
    objects.take([carried])  # the others are in a receptacle
    objects.take([replace(one, p_world_m=np.array([0.05, 0.06, 0.0]))])
    assert_allclose(objects.values.reshape(3, -1)[1, :2], [0.05, 0.06])
    env.close()


def test_an_episode_lasts_until_its_budget_where_nothing_is_looked_at_any_more(monkeypatch):
    async def watch(self):
        """Everything is seen."""

    monkeypatch.setattr(WatchedObjects, "watch", watch)
    env = CellEnv("peg-transfer", observation=("state", "objects"), transfers=1, budget_s=0.2)
    env.reset(seed=1)
    action = still(env)
    ends = [env.step(action)[3] for _ in range(6)]
    assert ends == [False] * 5 + [True]
    env.close()


@pytest.mark.usefixtures("registries")
def test_a_task_without_objects_says_so():
    load_plugin("examples/three_dots.py")
    with pytest.raises(InvalidInput, match="'objects' is nothing in this task"):
        CellEnv("dots", observation=("state", "objects"))
