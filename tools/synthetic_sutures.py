"""Make the synthetic set of suture demonstrations that ships with the package; it was not recorded on any robot.

Run: .venv/bin/python tools/synthetic_sutures.py src/trocar/tasks/suture/demonstrations/synthetic_set
"""

from __future__ import annotations

import sys
from math import degrees, radians
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ik_unbounded
from trocar.files.output import make_folder, write_table, write_text
from trocar.geometry import SE3, SO3, TURN
from trocar.tasks.suture.demonstrations import NAME
from trocar.tasks.suture.planning.primitive import needle_poses, steps, tip_poses, turned_to
from trocar.tasks.suture.planning.rewards import PRESETS, dexterity
from trocar.tasks.suture.planning.setup import DIRECTIONS, base_beside

SOURCE = "synthetic demonstrations: made by a program from the needle primitive with wandering hands, not recorded"
SETUP = PRESETS["default"].setup
SEED = 20260
PLACES = 8  # two sutures at each of eight places, as in the paper (IV-A2)
TAKES = 2
ROWS = 24
SECOND_BASE = base_beside(radians(315.0), 0.070, 0.130, tilt_rad=radians(40.0), spin_rad=radians(-45.0))
"""The first arm's base mirrored in the plane x = 0, but farther away, which keeps the arm off its joints' limits."""

WANDER_M, WANDER_RAD = 0.003, radians(8.0)
HOVER_M, PULL_M = 0.020, 0.045


def synthetic_suture(theta_rad: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return joints (rows, 2, 6) of a simulated teleoperated suture: the first arm drives the needle, the second pulls.

    The first arm comes down, follows the needle primitive in the direction that the default reward prefers, and lifts
    the thread; the second hovers beside the exit, grasps the needle's tip there and pulls it out and up. Both wander
    smoothly about these paths, and are kept within their joints' ranges.
    """
    hover, pull = HOVER_M * rng.uniform(0.7, 1.3), PULL_M * rng.uniform(0.7, 1.3)
    row, sign = _preferred(theta_rad)
    first = _driving(theta_rad, row, hover, pull)
    second = _pulling(theta_rad, row, sign, hover, pull)
    q = []
    for T_circle_tip, base in ((first, SETUP.T_world_base), (second, SECOND_BASE)):
        T_base_tip = base.inverse() @ SETUP.circle.T_world_circle @ T_circle_tip @ _wander(rng)
        solved = ik_unbounded(SETUP.arm, T_base_tip)
        solved[:, 3] = np.unwrap(solved[:, 3])
        q.append(np.clip(solved, SETUP.arm.lower, SETUP.arm.upper))
    return np.stack(q, 1)


def write_synthetic(folder: str | Path, rng: np.random.Generator) -> None:
    """Write the manifest and one CSV file per suture to a folder."""
    folder = Path(folder)
    make_folder(folder)
    names = [joint.name for joint in SETUP.arm.joints]
    columns = [f"{arm}_{name}" for arm in ("psm1", "psm2") for name in names]
    lines = [f'source = "{SOURCE}"', f'arms = ["{SETUP.arm.name}", "{SETUP.arm.name}"]']
    for theta in np.arange(PLACES) * (TURN / PLACES):
        for take in range(1, TAKES + 1):
            name = f"synthetic_{degrees(theta):03.0f}_{take}.csv"
            values = synthetic_suture(float(theta), rng).reshape(ROWS, 12)
            write_table(folder / name, columns, ([f"{value:.4f}" for value in row] for row in values))
            lines += ["", "[[sutures]]", f'file = "{name}"', f"theta_deg = {degrees(theta):.0f}"]
    write_text(folder / NAME, "\n".join(lines) + "\n", "manifest of demonstrations")


def _preferred(theta_rad: float) -> tuple[int, int]:
    """Return the direction that the default reward prefers near theta: its row of ``DIRECTIONS``, and its sign."""
    map = dexterity(SETUP)
    row = int(map.choice[np.argmin(np.abs(np.angle(np.exp(1j * (map.thetas_rad - theta_rad)))))])
    return row, DIRECTIONS[row]


def _driving(theta_rad: float, row: int, hover_m: float, pull_m: float) -> SE3:
    """Return poses (rows,) of the first arm's tip in the circle's frame."""
    movements = steps(SETUP)
    knots = [(0.0, 0.0, hover_m)]
    knots += [(step.advance_m[0], step.jaws_rad[0], 0.0) for step in movements]
    knots += [(movements[-1].advance_m[1], movements[-1].jaws_rad[1], 0.0)]
    knots += [(movements[-1].advance_m[1], movements[-1].jaws_rad[1], pull_m)]
    advance, jaws, lift = _eased(np.array(knots)).T
    poses = turned_to(tip_poses(SETUP, advance, jaws), [theta_rad])[row, 0]
    return SE3.from_parts(SO3.identity(), np.stack([0 * lift, 0 * lift, lift], -1)) @ poses


def _pulling(theta_rad: float, row: int, sign: int, hover_m: float, pull_m: float) -> SE3:
    """Return poses (rows,) of the second arm's tip in the circle's frame, in the orientation of its base."""
    straight, turn = SETUP.insertion.straight_m, SETUP.exit_turn_rad
    needle = turned_to(needle_poses(SETUP, [straight], [turn]), [theta_rad])[row, 0, 0]
    way_out = needle.apply([0.0, -SETUP.needle.radius_m, 0.0])
    heading = SO3.axis("z", theta_rad).apply([0.0, -float(sign), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    beside = way_out + 1.5 * hover_m * heading + hover_m * up
    pulled = way_out + 0.5 * pull_m * heading + pull_m * up
    points = _eased(np.stack([beside, beside, beside, way_out, pulled, pulled]))
    R_circle_tip = SETUP.circle.T_world_circle.rotation.inverse() @ SECOND_BASE.rotation
    return SE3.from_parts(R_circle_tip, points)


def _eased(knots: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rows (ROWS, m) that move from knot to knot (k, m) and slow down at each."""
    place = np.linspace(0.0, len(knots) - 1.0, ROWS)
    start = np.minimum(place.astype(int), len(knots) - 2)
    part = place - start
    part = (part * part * (3 - 2 * part))[:, None]
    return (1 - part) * knots[start] + part * knots[start + 1]


def _wander(rng: np.random.Generator) -> SE3:
    """Return small smooth motions (rows,) about the identity: three slow waves per axis."""
    time = np.linspace(0.0, 1.0, ROWS)[:, None, None]
    waves = np.sin(TURN * (np.array([0.7, 1.6, 2.9]) * time + rng.uniform(0, 1, (6, 3))))
    twist = (waves * rng.normal(size=(6, 3)) * np.array([0.6, 0.3, 0.1])).sum(-1)
    return SE3.exp(twist * np.repeat([WANDER_M, WANDER_RAD], 3))


if __name__ == "__main__":
    write_synthetic(Path(sys.argv[1]), np.random.default_rng(SEED))
