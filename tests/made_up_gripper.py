"""Pairs of a made-up gripper with known true pose, with errors of the filter's model or of another kind."""

from dataclasses import dataclass

import numpy as np

from trocar.geometry import SE3, SO3
from trocar.tasks.debridement.pose import FilterSettings, PosePairs
from trocar.tasks.debridement.pose.error_filter import WAY_M, KinematicHistory

DEPTH = np.array([0.24, 0.80, 0.55])
"""Where the camera looks: detections err 3.7 mm along it and .5 mm across, as the recording's do."""
NOISE_M = 0.0005 * np.eye(3) + 0.0032 * np.outer(DEPTH, DEPTH) / (DEPTH @ DEPTH)
STEP_S = 0.2


@dataclass(frozen=True)
class MadeUp:
    """Pairs and the true poses (n,) behind the detected ones."""

    pairs: PosePairs
    T_base_true: SE3


def kinematics(rng, n):
    """Return a smooth random path: some 25 mm and 20 deg about a tool that points down."""
    t = STEP_S * np.arange(n)
    rates, phases = rng.uniform(0.1, 0.6, (2, 6)), rng.uniform(0, 2 * np.pi, (2, 6))
    twist = np.sin(rates[:, None] * t[:, None] + phases[:, None]).sum(0) * ([0.015] * 3 + [0.2] * 3)
    return t, SE3.from_parts(SO3.exp(twist[:, 3:]) @ SO3.axis("y", 1.4), [-0.1, -0.07, -0.12] + twist[:, :3])


def detect(rng, t, kinematic, T_true, outside=False):
    """Return the pairs of what a camera sees; ``outside`` gives its noise heavy tails."""
    n, tail = len(t), rng.standard_t(4, (len(t), 1)) / np.sqrt(2) if outside else np.ones((len(t), 1))
    shift = tail * rng.normal(size=(n, 3)) @ NOISE_M
    turn = rng.normal(0, 0.02, (n, 3))
    seen = SE3.from_parts(SO3.exp(turn) @ T_true.rotation, T_true.translation_m + shift)
    return MadeUp(PosePairs(t, seen, kinematic), T_true)


def of_its_kind(rng, n, settings=None):
    """Return pairs whose error is drawn from what the filter assumes."""
    s = settings or FilterSettings()
    t, kinematic = kinematics(rng, n)
    p_gains = rng.normal(size=16) * ([s.constant_m] * 3 + [s.lag_gain] + [s.tool_m] * 3 + [s.tilt] * 9)
    r_gains = rng.normal(size=13) * ([s.constant_rad] * 3 + [s.lag_gain] + [s.turn_gain] * 9)
    steps = np.sqrt(np.linalg.norm(np.diff(kinematic.translation_m, axis=0), axis=-1) / WAY_M)
    drift_m = wander(rng, s.drift_m, s.drift_s, s.way_m * steps)
    drift_rad = wander(rng, s.drift_rad, s.drift_s, s.way_rad * steps)
    first = SO3.exp(r_gains[:3])
    history, poses = None, []
    for i in range(n):
        T = kinematic[i]
        history = history.then(t[i], T) if history else KinematicHistory.begin(t[i], T, s.lag_s)
        shift = history.translation_design()[:, [0, 1, 2, *range(6, 19)]] @ p_gains + drift_m[i]
        turn = history.rotation_design()[:, 6:] @ r_gains[3:] + drift_rad[i]
        poses.append(SE3.from_parts(SO3.exp(turn) @ first @ T.rotation, T.translation_m + shift).matrix)
    return detect(rng, t, kinematic, SE3(np.array(poses)))


def of_another_kind(rng, n):
    """Return pairs of an arm with backlash of 4 mm, a rigid error on the left, a jump of 8 mm half-way, heavy tails."""
    t, kinematic = kinematics(rng, n)
    p = kinematic.translation_m.copy()
    for i in range(1, n):
        pull = p[i] - p[i - 1]
        p[i] = p[i - 1] + pull * max(0.0, 1 - 0.004 / max(np.linalg.norm(pull), 1e-12))
    p[n // 2 :] += [0.008, 0.0, 0.0]
    T_left = SE3.exp([*rng.normal(0, 0.015, 3), *rng.normal(0, 0.1, 3)])
    return detect(rng, t, kinematic, T_left @ SE3.from_parts(kinematic.rotation, p), outside=True)


def wander(rng, sd, time_s, steps):
    """Return an Ornstein-Uhlenbeck path (n, 3) that wanders besides by ``steps`` (n - 1,) from row to row."""
    kept, path = np.exp(-STEP_S / time_s), [rng.normal(0, sd, 3)]
    for step in steps:
        path.append(kept * path[-1] + rng.normal(0, np.hypot(sd * np.sqrt(1 - kept**2), step), 3))
    return np.array(path)
