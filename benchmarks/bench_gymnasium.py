"""Environments: steps per second of one core, beside MuJoCo alone on the same scene, and scaling over processes.

Random joint actions in the peg transfer with one arm. Times of one process are processor times, which hold on a busy
machine too; those of several processes are wall-clock times. `--random N` also takes N random steps in every task, and
stops at an observation out of bounds. Two minutes without it.

Run: .venv/bin/python benchmarks/bench_gymnasium.py [--steps N] [--random N]
"""

import argparse
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gymnasium
import mujoco
from bench_simulator import mean_speed

import trocar.learn.envs
from trocar.eval import TASKS
from trocar.learn.environment import CellEnv
from trocar.sim.spec import TIMESTEP_S

RATE_HZ = 30.0
WARM = 20
AT_ONCE = 150
"""Steps between two measurements of the machine's speed."""
SPEED_RUNS = 6


def steps_a_second(steps, **options):
    """Return steps per second of processor time here and at the reference's speed, and the seconds of a reset.

    A machine's speed changes within seconds, so it is measured anew before and after each few steps.
    """
    env = CellEnv("peg-transfer", rate_hz=RATE_HZ, **options)
    began = time.process_time()
    env.reset(seed=0)
    reset_s = time.process_time() - began
    env.action_space.seed(0)
    for _ in range(WARM):
        env.step(env.action_space.sample())
    spent_s, at_reference_s, speed = 0.0, 0.0, mean_speed(SPEED_RUNS)
    for first in range(0, steps, AT_ONCE):
        began = time.process_time()
        for _ in range(min(AT_ONCE, steps - first)):
            if env.step(env.action_space.sample())[3]:
                env.reset()
        here_s, before = time.process_time() - began, speed
        speed = mean_speed(SPEED_RUNS)
        spent_s += here_s
        at_reference_s += here_s * (before + speed) / 2
    env.close()
    return steps / spent_s, steps / at_reference_s, reset_s


def alone(steps):
    """Return the same rates of MuJoCo alone on the same scene, here and at the reference's speed."""
    env = CellEnv("peg-transfer", rate_hz=RATE_HZ)
    env.reset(seed=0)
    world, speed = env.unwrapped._laboratory.world, mean_speed(SPEED_RUNS)
    began = time.process_time()
    mujoco.mj_step(world.model, world.data, round(steps / RATE_HZ / TIMESTEP_S))
    found = steps / (time.process_time() - began)
    env.close()
    return found, 2 * found / (speed + mean_speed(SPEED_RUNS))


def scaled(steps, processes):
    """Return steps per second of wall time of environments in ``processes`` processes, all together."""
    envs = gymnasium.make_vec("trocar/PegTransfer-v0", num_envs=processes, vectorization_mode="async")
    envs.reset(seed=0)
    envs.action_space.seed(0)
    for _ in range(WARM):
        envs.step(envs.action_space.sample())
    began = time.perf_counter()
    for _ in range(steps):
        envs.step(envs.action_space.sample())
    seconds = time.perf_counter() - began
    envs.close()
    return processes * steps / seconds


def driven(task, steps):
    """Take random steps; return the arms' largest share of a limit; end if an observation leaves its bounds."""
    env = gymnasium.make(trocar.learn.envs.environment_id(task), disable_env_checker=True)
    env.action_space.seed(0)
    env.reset(seed=0)
    most = 0.0
    for _ in range(steps):
        seen, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if not env.observation_space.contains(seen):
            raise SystemExit(f"{task}: an observation left its bounds: {seen}")
        if terminated or truncated:
            driver = env.unwrapped._laboratory.driver
            most = max(most, *(max(driver.limit_use(arm)) for arm in driver.names))
            env.reset()
    driver = env.unwrapped._laboratory.driver
    most = max(most, *(max(driver.limit_use(arm)) for arm in driver.names))
    env.close()
    return most


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--random", type=int, default=0)
    asked = parser.parse_args()
    state, at_reference, reset_s = steps_a_second(asked.steps)
    rates = {
        "state": (state, at_reference),
        "state calibrated": steps_a_second(asked.steps // 4, calibrated=True)[:2],
        "state and images": steps_a_second(asked.steps // 10, observation=("state", "images"))[:2],
        "mujoco alone": alone(asked.steps),
    }
    print(f"steps of {1e3 / RATE_HZ:.0f} ms a second of one core, here and at the reference's speed")
    for name, (here, there) in rates.items():
        print(f"  {name:18} {here:7.0f} {there:7.0f}")
    print(f"a reset takes {reset_s:.2f} s; wall clock, by processes:")
    for count in sorted({1, os.cpu_count() or 1}):
        print(f"  {count:<18} {scaled(asked.steps // 4, count):7.0f}")
    for task in TASKS if asked.random else ():
        share = driven(task, asked.random)
        print(f"{task}: {asked.random} random steps used {100 * share:.1f} % of the limits at most")


if __name__ == "__main__":
    main()
