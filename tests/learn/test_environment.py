import hashlib
import subprocess
import sys
import weakref

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import trocar.learn.envs
from trocar.arms import fk
from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.eval import TASKS
from trocar.learn import environment
from trocar.learn.control import ACTIONS
from trocar.learn.environment import CellEnv
from trocar.registry import load_plugin

ONE = {"transfers": 1, "budget_s": 4.0}


def digest(env, seed, steps):
    """Return the digest of everything that an episode of random actions gives."""
    found, (seen, info) = hashlib.sha256(), env.reset(seed=seed)
    env.action_space.seed(seed)
    for _ in range(steps):
        for name in sorted(seen):
            found.update(seen[name].tobytes())
        found.update(repr((info["slowed"], info["refused"], info["session"], info["trial"])).encode())
        seen, _, terminated, truncated, info = env.step(env.action_space.sample())
        if terminated or truncated:
            break
    return found.hexdigest()


def still(env):
    """Return the action that leaves an environment's arms where they are."""
    return np.clip(env._control.observe()["joints"].astype(np.float64), env.action_space.low, env.action_space.high)


@pytest.fixture(scope="module")
def peg():
    env = CellEnv("peg-transfer", **ONE)
    yield env
    env.close()


def kinds():
    """Return every registered task, with each of its variants."""
    for name in TASKS:
        fields = TASKS[name].__dataclass_fields__
        variants = fields["variant"].metadata.get("choices", ()) if "variant" in fields else ()
        yield from ((name, {"variant": variant}) for variant in variants) if variants else [(name, {})]


@pytest.mark.slow
@pytest.mark.parametrize(("task", "options"), list(kinds()), ids=str)
def test_every_task_and_variant_is_an_environment(task, options):
    env = gymnasium.make(trocar.learn.envs.environment_id(task), **options)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("observation", [("state", "privileged"), "images"], ids=str)
def test_every_action_and_observation_passes_the_checks(action, observation):
    env = CellEnv("peg-transfer", action=action, observation=observation, **ONE)
    assert all(name.isidentifier() for name in env.observation_space), "PyTorch's ModuleDict takes no dots"
    check_env(env, skip_render_check=True)
    env.close()


@pytest.mark.usefixtures("registries")
def test_a_task_from_a_file_has_its_environment():
    load_plugin("examples/three_dots.py")
    env = gymnasium.make("trocar/Dots-v0", budget_s=1.0)
    seen, info = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    assert len(info["scores"]) == 3 and not info["privileged"]
    env.close()


@pytest.mark.parametrize("action", ACTIONS)
def test_random_actions_break_no_limit_and_no_bound(action):
    env = CellEnv("peg-transfer", action=action, **{**ONE, "budget_s": 2.0})
    env.action_space.seed(3)
    seen, _ = env.reset(seed=3)
    arm, truncated, touched = env.config.arms[0], False, False
    model = env._laboratory.cell.arms[arm]
    while not truncated:
        assert env.observation_space.contains(seen)
        seen, _, _, truncated, info = env.step(env.action_space.sample())
        q = env._laboratory.driver.setpoint(arm).q
        assert np.all(q >= model.lower - 1e-9) and np.all(q <= model.upper + 1e-9)
        touched = touched or bool(info["slowed"]) or bool(info["refused"])
    assert touched, "random actions ask for more than an arm may do, and the info says so"
    assert max(env._laboratory.driver.limit_use(arm)) <= 1.0 + 1e-6
    env.close()


def test_the_same_seed_gives_the_same_bytes(peg):
    first = digest(peg, 7, 20)
    assert digest(peg, 7, 20) == first
    assert digest(peg, 8, 20) != first
    code = (
        "import sys; sys.path.insert(0, 'tests/learn'); import test_environment as t; "
        "print(t.digest(t.CellEnv('peg-transfer', **t.ONE), 7, 20))"
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == first


def test_thirty_steps_are_a_second(peg):
    peg.reset(seed=0)
    start = still(peg)
    for _ in range(30):
        _, reward, terminated, _, info = peg.step(start)
    assert info["time_s"] == pytest.approx(1.0)
    assert (reward, terminated, info["score"]) == (0.0, False, 0.0)


def test_an_arm_goes_where_its_actions_say_and_is_slowed_where_it_cannot(peg):
    peg.reset(seed=0)
    start = peg._control.observe()["joints"].astype(np.float64)
    goal = np.clip(start + [0.05, 0.05, 0.005, 0, 0, 0, 0], peg.action_space.low, peg.action_space.high)
    info = peg.step(goal)[-1]
    assert info["slowed"][peg.config.arms[0]] > 1.0, "the goal jumps"
    for _ in range(45):
        seen, *_, info = peg.step(goal)
    assert info["slowed"] == {}
    assert np.allclose(seen["joints"][:6], goal[:6], atol=1e-4)


def test_increments_that_are_too_fast_do_not_turn_the_arm():
    env = CellEnv("peg-transfer", action="cartesian", transfers=1, budget_s=15.0)
    seen, _ = env.reset(seed=1)
    arm, cell, jaw_rad = env.config.arms[0], env._laboratory.cell, float(seen["state"][-1])

    def turn():
        return fk(cell.arms[arm], cell.robot.setpoint(arm).q).rotation

    for _ in range(20):  # a tilt, so that the wrist does not just undo what the outer joints do
        env.step(np.array([0, 0, 0, 0.01, 0.015, 0.01, jaw_rad]))
    for _ in range(3):
        env.step(np.array([0, 0, 0, 0, 0, 0, jaw_rad]))
    tilted, fast = turn(), env.action_space.high[:3]
    for there in [-1] * 6 + [1] * 6 + [0] * 8:
        info = env.step(np.array([*(there * fast), 0, 0, 0, jaw_rad]))[-1]
        slowed = info["slowed"] or there == 0
        assert slowed and not info["refused"]
        assert np.degrees(np.linalg.norm((turn() @ tilted.inverse()).log())) < 0.5
    rng, worst_rad = np.random.default_rng(1), 0.0
    for step in range(300):  # another way each quarter of a second: errors do not add up
        there = np.sign(rng.uniform(-1.0, 1.0, 3)) if step % 8 == 0 else there
        env.step(np.array([*(there * fast), 0, 0, 0, jaw_rad]))
        worst_rad = max(worst_rad, np.linalg.norm((turn() @ tilted.inverse()).log()))
    assert np.degrees(worst_rad) < 8.0
    env.close()


def test_the_budget_truncates_and_nothing_follows(peg):
    peg.reset(seed=0)
    action, truncated, steps = still(peg), False, 0
    while not truncated:
        _, _, terminated, truncated, info = peg.step(action)
        steps += 1
    assert (steps, terminated, info["score"]) == (120, False, 0.0)
    with pytest.raises(InvalidInput, match=r"step\(\) has no episode to go on with.*reset"):
        peg.step(action)


def test_the_referee_looks_once_a_second_and_less_often_in_a_long_episode(monkeypatch):
    looks = {}
    for share in (0.03, 1.0):
        monkeypatch.setattr(environment, "REFEREE_SHARE", share)
        env = CellEnv("peg-transfer", transfers=1, budget_s=4.5)
        env.reset(seed=0)
        action, over, looks[share] = still(env), False, []
        while not over:
            over = env.step(action)[3]
            looks[share].append(round(env._scored_s, 1))
        env.close()
    assert sorted(set(looks[0.03])) == [0.0, 1.0, 2.0, 3.0, 4.0, 4.5], "and at the end"
    assert sorted(set(looks[1.0])) == [0.0, 1.0, 2.0, 4.0, 4.5]


def test_bad_actions_are_refused_in_a_sentence_and_nothing_is_lost(peg):
    peg.reset(seed=0)
    good = still(peg)
    with pytest.raises(InvalidValue, match=r"psm1_sp\.yaw of the action is nan"):
        peg.step(np.full(7, np.nan))
    with pytest.raises(InvalidInput, match=r"has the shape \(3,\); give 7 numbers: psm1_sp\.yaw"):
        peg.step(np.zeros(3))
    with pytest.raises(InvalidInput, match="str, not numbers"):
        peg.step("up")
    with pytest.raises(InvalidValue, match=r"psm1_sp\.yaw of the action is 99; give -"):
        peg.step(np.append(99.0, good[1:]))
    assert peg.step(good)[-1]["time_s"] == pytest.approx(0.03), "the episode goes on"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"action": "torques"}, "action 'torques' is unknown"),
        ({"observation": "pixels"}, "observation 'pixels' is unknown"),
        ({"observation": ()}, "observation '' is unknown"),
        ({"rate_hz": 500}, "rate of actions is 500 Hz; give 1 to 100"),
        ({"rate_hz": "30"}, "rate of actions is '30' Hz; give 1 to 100"),
        ({"budget_s": "5"}, "budget_s is '5'; give a number"),
        ({"flaws": "weer=2x"}, "flaw 'weer' is unknown"),
        ({"calibrated": "yes"}, "calibrated is 'yes'; give True or False"),
        ({"calibrated": 1}, "calibrated is 1; give True or False"),
        ({"calibration": "images"}, "calibration 'images' fits no model; drop it, or give calibrated=True"),
        ({"render_mode": "ansi"}, "render_mode 'ansi' is unknown"),
        ({"colour": 1}, "option of the environment of 'peg-transfer' 'colour' is unknown"),
        ({"difficulty": "hard"}, "hard"),
    ],
    ids=str,
)
def test_bad_options_are_refused(options, said):
    with pytest.raises(InvalidInput, match=said):
        CellEnv("peg-transfer", **options)


def test_a_reset_to_a_session_that_is_not_there_is_refused(peg):
    with pytest.raises(InvalidValue, match=r"the session of reset\(\) is 99; give a whole number from 0 to 9"):
        peg.reset(options={"session": 99})
    for name in ("session", "trial"):
        with pytest.raises(InvalidValue, match=rf"the {name} of reset\(\) is True; give a whole number from 0"):
            peg.reset(options={name: True})
    with pytest.raises(UnknownName, match="'scene'"):
        peg.reset(options={"scene": 1})
    _, info = peg.reset(options={"session": np.int64(3), "trial": 5})
    assert (info["session"], info["trial"]) == (3, 5)


def test_a_reset_frees_the_memory_of_the_episode_before_it(peg):
    peg.reset(seed=0)
    before = weakref.ref(peg._laboratory)
    peg.reset(seed=0)
    assert before() is None


def test_the_truth_is_observed_on_request_alone():
    env = CellEnv("peg-transfer", observation=("state", "privileged"), **ONE)
    seen, info = env.reset(seed=0)
    assert info["privileged"] and seen["privileged"].shape == (42,)
    assert env.observation_names["privileged"][:2] == ["block0.position.x", "block0.position.y"]
    assert np.allclose(seen["privileged"][:3], env._laboratory.world.free_pose("block0").translation_m, atol=1e-6)
    env.close()


def test_a_picture_for_people():
    env = CellEnv("peg-transfer", render_mode="rgb_array", rate_hz=10.0, **ONE)
    assert env.metadata["render_fps"] == 10.0 and CellEnv.metadata["render_fps"] == 30, "a video is as fast as the cell"
    env.reset(seed=0)
    first = env.render()
    assert first.ndim == 3 and first.dtype == np.uint8 and first.std() > 10
    env.action_space.seed(0)
    for _ in range(10):
        env.step(env.action_space.sample())
    assert (env.render() != first).any()
    env.close()


@pytest.mark.usefixtures("registries")
def test_the_dense_reward_adds_up_to_the_way_that_was_gained():
    load_plugin("examples/three_dots.py")
    env = CellEnv("dots", action="cartesian", reward="dense", budget_s=3.0)
    env.reset(seed=1)
    arm, world = env.config.arms[0], env._laboratory.world
    places, total = env._laboratory.task.places_m, 0.0

    def away_m():
        tip = world.T_world_base[arm] @ fk(world.models[arm], world.joints(arm))
        return np.linalg.norm(tip.translation_m - places[0])

    start_m, steps = away_m(), []
    for _ in range(30):
        tip = world.T_world_base[arm] @ fk(world.models[arm], world.joints(arm))
        way = places[0] + [0, 0, 0.02] - tip.translation_m
        action = np.hstack([0.9 * way / np.linalg.norm(way) * env.action_space.high[0], 0, 0, 0, 0.1])
        steps.append(env.step(action.clip(env.action_space.low, env.action_space.high))[1])
        total += steps[-1]
    assert total == pytest.approx(10 * (start_m - away_m()), abs=1e-6) and total > 0.5
    assert sum(step > 0 for step in steps) > 20, "it comes step by step"
    env.close()
    with pytest.raises(InvalidInput, match="has no dense reward"):
        CellEnv("suture", reward="dense")


@pytest.mark.parametrize("task", ["peg-transfer", "debridement"])
def test_what_is_left_leads_to_an_object_and_from_there_to_its_place(task):
    env = CellEnv(task, reward="dense", budget_s=2.0)
    env.reset(seed=4)
    bodies = dict(zip(env._laboratory.world.free_bodies, env._laboratory.world.free_poses()[:, :3], strict=True))
    here, there = env._laboratory.task.errand(env.config.task.goals()[0])
    assert min(np.linalg.norm(here - place) for place in bodies.values()) < 1e-9
    assert 0.02 < np.linalg.norm(there - here) < 0.2
    assert env._left_m > np.linalg.norm(there - here)
    env.close()
