"""What arms and bodies did in one trial, 100 times a second, as a flat table."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk
from trocar.eval.trial import Trial
from trocar.geometry import SE3
from trocar.report.export.notes import PLACE
from trocar.report.export.table import Column, FlatTable

KINDS = {
    "desired": "as the script asked for",
    "commanded": "as it was sent to the controller, corrected for the cables",
    "measured": "as the encoders read it",
    "true": "as it really was, which only the referee knows",
}
QUATERNION = ("qw", "qx", "qy", "qz")
Values = tuple[Column, NDArray[Any]]


def samples_of(trial: Trial) -> FlatTable:
    """Return a row for each tick: time; of each arm joints, jaw and tip of all kinds; pose of each free body.

    Tips are in the world: the true one by the arm's true base, all others by the base as it was registered.
    """
    times = trial.times_s
    found: list[Values] = [
        (column, np.full(len(times), trial.about[key])) for column, key in zip(PLACE, ("session", "index"), strict=True)
    ]
    found.append((Column("time_s", "on the trial's clock", "number", "s"), times))
    for name, arm in trial.scenery.arms.items():
        for kind in KINDS:
            rows = trial.arrays.get(f"{kind}_{name}")
            if rows is not None:
                found += _of_arm(trial, name, arm, kind, rows.astype(np.float64))
    for key, rows in trial.arrays.items():
        if key.startswith("body_"):
            body = key.removeprefix("body_")
            found += _pose(body, f"of {body} in the world", rows.astype(np.float64))
    return FlatTable("samples", tuple(column for column, _ in found), tuple(values for _, values in found))


def _of_arm(trial: Trial, name: str, arm: ArmModel, kind: str, rows: NDArray[np.float64]) -> Iterator[Values]:
    """Yield the columns of one arm's joints (n, 7), jaw and tip of one kind."""
    for number, joint in enumerate(arm.joints):
        column = f"{name}_q{number + 1}_{kind}_{joint.unit}"
        yield Column(column, f"{joint.name} of {name}, {KINDS[kind]}", "number", joint.unit), rows[:, number]
    yield Column(f"{name}_jaw_{kind}_rad", f"jaws of {name}, {KINDS[kind]}", "number", "rad"), rows[:, 6]
    scenery = trial.scenery
    base = scenery.T_world_base[name] if kind == "true" else scenery.T_world_base_registered[name]
    tip = base @ fk(arm, rows[:, :6])
    seven = np.column_stack([tip.translation_m, _quaternions(tip)])
    yield from _pose(f"{name}_tip_{kind}", f"of the tip of {name} in the world, {KINDS[kind]}", seven)


def _pose(name: str, about: str, rows: NDArray[np.float64]) -> Iterator[Values]:
    """Yield the columns of poses (n, 7): position m, quaternion wxyz."""
    for place, axis in enumerate("xyz"):
        yield Column(f"{name}_{axis}_m", f"{axis} {about}", "number", "m"), rows[:, place]
    for place, part in enumerate(QUATERNION, 3):
        yield Column(f"{name}_{part}", f"orientation {about}, quaternion", "number"), rows[:, place]


def _quaternions(poses: SE3) -> NDArray[np.float64]:
    """Return quaternions (n, 4) wxyz that do not jump from one row to the next."""
    found = poses.rotation.as_quaternion()
    turned = np.cumprod(np.where((found[1:] * found[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    return found * np.concatenate([[1.0], turned])[:, None]
