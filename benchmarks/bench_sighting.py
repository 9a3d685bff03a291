"""Wrist joints of an instrument from a depth image: errors, the uncertainty that is stated, and the time it takes.

    python benchmarks/bench_sighting.py [--sessions N] [--looks N] [--difficulty LEVEL] [--shape MM]

In each session, an arm is put in as many configurations over the board as `adaptive` looks at before its first
transfer. The expected wrist is off by .08 -.05 .06 rad, plus noise of .03 rad (SD); outer joints and base are off as
the difficulty says. With ``--shape``, the true instrument's radii, lengths and widths differ from the fitted ones by
this SD, drawn anew in each session. Only the times depend on the machine.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from trocar.arms import ArmModel
from trocar.lab import load_station
from trocar.lab.flaws import LEVELS, Difficulty
from trocar.lab.session import draw_session
from trocar.perception.instrument import sight
from trocar.robots.adaptive import Observation, combine, joints_seen
from trocar.sim.calibration_cells import EmptyTable
from trocar.sim.ray_camera import RayCamera
from trocar.sim.sensor import Light
from trocar.sim.world import World

ARM, CAMERA, JAW_RAD = "psm1", "overhead", 0.9
OFF_RAD, MORE_RAD = np.array([0.08, -0.05, 0.06]), 0.03
DIMENSIONS = (
    "shaft_radius_m",
    "wrist_radius_m",
    "knuckle_radius_m",
    "finger_length_m",
    "finger_base_m",
    "finger_tip_m",
    "finger_width_m",
)
LOWER, UPPER = np.array([-1.3, -0.9, -1.0]), np.array([1.3, 0.9, -0.2])


def misshapen(arm: ArmModel, shape_m: float, number: int) -> ArmModel:
    """Return an arm whose instrument's dimensions are off by ``shape_m`` (SD)."""
    rng, instrument = np.random.default_rng([1, number]), arm.instrument
    off = {name: getattr(instrument, name) + shape_m * rng.standard_normal() for name in DIMENSIONS}
    return replace(arm, instrument=replace(instrument, **off))


def looks_of(number: int, count: int, level: str, shape_m: float) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Return a session's errors (n, 3), the same divided by their stated SDs, and times in s."""
    rng = np.random.default_rng([0, number])
    station = replace(load_station("peg-transfer"), difficulty=Difficulty.of(level))
    session = draw_session(station, rng)
    camera = session.station.cameras[CAMERA]
    true, known = misshapen(session.models[ARM], shape_m, number), station.arm(ARM).model
    world = World({ARM: true}, {ARM: session.T_world_base[ARM]}, EmptyTable())
    light = Light(gain=camera.gain)
    eye = RayCamera(world.model, camera.model, session.T_world_camera[CAMERA], camera.lamp_m, camera.flaws, light)
    T_base_camera = session.T_world_base_registered[ARM].inverse() @ session.T_world_camera_registered[CAMERA]
    outer_sd = station.difficulty["outer"] / np.array([0.15, 0.15, 1.0])
    joints = np.tile(station.arm(ARM).park_q(), (count, 1))
    joints[:, 3:] = rng.uniform(LOWER, UPPER, (count, 3))
    looks, took = [], []
    for row, q in enumerate(joints):
        world.place_arm(ARM, q, JAW_RAD)
        expected = q + np.append(rng.normal(0.0, outer_sd), OFF_RAD + rng.normal(0.0, MORE_RAD, 3))
        image, begin = eye.render(world.data, rng), time.perf_counter()
        seen = sight(image, T_base_camera, known, expected, JAW_RAD)
        took.append(time.perf_counter() - begin)
        if seen is not None:
            looks.append(Observation(row, seen))
    shift_m = combine(known, "looks", joints, looks).shift_m
    errors, scores = [], []
    for look in looks:
        q, covariance = joints_seen(known, look.sighting, shift_m)
        errors.append((q - joints[look.row])[3:])
        scores.append(errors[-1] / np.sqrt(np.diag(covariance)))
    return np.array(errors), np.array(scores), took


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=10)
    parser.add_argument("--looks", type=int, default=36)
    parser.add_argument("--difficulty", default="recorded", choices=LEVELS)
    parser.add_argument("--shape", type=float, default=0.0, help="SD of the instrument's dimensions, mm")
    asked = parser.parse_args()
    found = [looks_of(number, asked.looks, asked.difficulty, 1e-3 * asked.shape) for number in range(asked.sessions)]
    errors, scores = np.concatenate([e for e, _, _ in found]), np.concatenate([s for _, s, _ in found])
    means = np.array([e.mean(axis=0) for e, _, _ in found])
    took = np.concatenate([t for *_, t in found])

    def shown(values: np.ndarray) -> str:
        return " ".join(f"{value:.3f}" for value in values)

    print(f"{len(errors)} of {asked.sessions * asked.looks} looks saw the wrist; q4 q5 q6")
    print(f"| median error of one look, rad | {shown(np.median(np.abs(errors), axis=0))} |")
    print(f"| RMS error of one look, rad | {shown(np.sqrt(np.mean(errors**2, axis=0)))} |")
    print(f"| RMS of a session's mean error, rad | {shown(np.sqrt(np.mean(means**2, axis=0)))} |")
    print(f"| RMS of errors over the SD that was said | {shown(np.sqrt(np.mean(scores**2, axis=0)))} |")
    print(f"time of one look on this machine: median {np.median(took):.3f} s, p95 {np.percentile(took, 95):.3f} s")


if __name__ == "__main__":
    main()
