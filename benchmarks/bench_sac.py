"""SAC of Stable-Baselines3 learns to touch a ball that the camera finds; --check runs its checks of environments.

PyTorch and Stable-Baselines3 are not dependencies of Trocar: install them into SITE_PACKAGES for this benchmark.

Run: PYTHONPATH=SITE_PACKAGES .venv/bin/python benchmarks/bench_sac.py [--check] [--minutes 10]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import SubprocVecEnv

import trocar.learn.envs
from trocar.eval import TASKS
from trocar.learn.control import ACTIONS
from trocar.learn.environment import REWARDS
from trocar.registry import load_plugin

PLUGIN = str(Path(__file__).parent / "reach.py")
GAMMA = 0.9
SHARE = 0.4
"""Share of the largest increments that is used, so that joints mostly keep up (assumed)."""
PER_DECIMETRE = 30.0
"""Reward for a decimetre nearer to the ball, and for touching it. SAC weighs rewards against randomness for its own
sake: with 10 instead of 1, all else the same, it touched 13 to 27 % instead of none after 3000 to 6500 steps."""


class Straight(gymnasium.Wrapper):
    """Three actions, the increments of the tip's position, from -1 to 1: the tool keeps its orientation, jaws closed.

    Nine observations, in decimetres: the tip's position, the vector from tip to ball (0 before it was seen), and the
    tip's motion in the last step, since an arm cannot stop at once.
    """

    def __init__(self, env: gymnasium.Env):
        super().__init__(env)
        self.most: np.ndarray = env.action_space.high  # type: ignore[attr-defined]
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
        self.observation_space = gymnasium.spaces.Box(-20.0, 20.0, (9,), np.float32)
        self.last_m = np.zeros(3)

    def reset(self, **options: Any) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode."""
        seen, info = self.env.reset(**options)
        self.last_m = seen["state"][:3]
        return self.seen(seen), info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Move the tip."""
        increment = np.append(SHARE * action * self.most[:3], np.zeros(4)).astype(np.float32)
        seen, reward, *ends, info = self.env.step(increment)
        return self.seen(seen), PER_DECIMETRE * float(reward), *ends, info

    def seen(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Return the nine observations."""
        tip, ball, last, self.last_m = seen["state"][:3], seen["objects"], self.last_m, seen["state"][:3]
        return 10 * np.hstack([tip, ball - tip if ball.any() else np.zeros(3), tip - last]).astype(np.float32)


def made(seed: int) -> Callable[[], gymnasium.Env]:
    """Return a function that makes the environment: one ball, four seconds, ten increments of the tip a second."""

    def make() -> gymnasium.Env:
        load_plugin(PLUGIN)  # in each process
        env: Any = gymnasium.make(
            trocar.learn.envs.environment_id("reach"),
            budget_s=4.0,
            action="cartesian",
            rate_hz=10.0,
            observation=("state", "objects"),
            reward="dense",
            calibrated=True,
            difficulty="mild",
            seed=seed,
        )
        return Monitor(Straight(env))

    return make


class Clock(BaseCallback):
    """Ends the learning after some minutes."""

    def __init__(self, minutes: float):
        super().__init__()
        self.ends_s = time.monotonic() + 60 * minutes

    def _on_step(self) -> bool:
        return time.monotonic() < self.ends_s


def check() -> None:
    """Let Stable-Baselines3 check every task, variant, action, observation and reward."""
    for task in TASKS:
        fields = TASKS[task].__dataclass_fields__
        variants = fields["variant"].metadata.get("choices", ()) if "variant" in fields else ()
        seen = ["state", "images", "privileged"] + (["objects"] if TASKS[task].objects is not None else [])
        ways = [{"variant": variant} for variant in variants] or [{}]
        ways += [{"action": action} for action in ACTIONS] + [{"observation": part} for part in seen]
        ways += [{"reward": reward} for reward in REWARDS] + [{"calibrated": True}]
        for how in ways:
            try:
                env = gymnasium.make(trocar.learn.envs.environment_id(task), budget_s=3.0, **how)
            except trocar.errors.InvalidInput as error:
                print(f"{task} {how}: refused: {error}")
                continue
            check_env(env.unwrapped, warn=False)
            env.close()
            print(f"{task} {how}: passed", flush=True)


def touched(model: SAC, episodes: int) -> float:
    """Return the share of new episodes in which the ball was touched."""
    env, done = made(199)(), 0
    for episode in range(episodes):
        seen, info = env.reset(seed=2000 + episode)
        over = False
        while not over:
            action, _ = model.predict(seen, deterministic=True)
            seen, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        done += info["score"] == 1.0
    env.close()
    return done / episodes


def main() -> None:
    """Learn, and print how often the ball is touched afterwards."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--episodes", type=int, default=60)
    given = parser.parse_args()
    if given.check:
        check()
        return
    torch.set_num_threads(1)  # the environments need the other core
    env = SubprocVecEnv([made(seed) for seed in range(2)])
    model = SAC(
        "MlpPolicy",
        env,
        seed=0,
        gamma=GAMMA,
        learning_rate=1e-3,
        learning_starts=300,
        train_freq=1,
        gradient_steps=8,  # four for each step of an environment
        batch_size=256,
        ent_coef="auto_0.1",
        policy_kwargs={"net_arch": [64, 64]},
    )
    began = time.monotonic()
    model.learn(10_000_000, callback=Clock(given.minutes))
    minutes = (time.monotonic() - began) / 60
    env.close()
    share = touched(model, given.episodes)
    print(f"{model.num_timesteps} steps in {minutes:.1f} minutes: {100 * share:.0f} % of {given.episodes} new episodes")


if __name__ == "__main__":
    main()
