"""Recorded joint states in tables."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.errors import BadFile
from trocar.files.csv_file import read_csv
from trocar.geometry import shown
from trocar.tasks.suture.demonstrations.manifest import Manifest

BEYOND = 0.1
"""Share of its range by which a recorded joint may leave it: encoders drift, but wrong units exceed it by far."""

MIN_TURN_RAD, MIN_DEPTH_M = math.radians(7.0), 0.5e-3
"""A suture turns some joint, and inserts some instrument, by more than this; radians read as degrees stay below 6.3
"degrees", and metres read as mm below .3 mm."""

INSERTION = 2
UNITS = "the units (angles and lengths in its manifest)"


def read_joints(path: Path, rows: slice, manifest: Manifest) -> NDArray[np.float64]:
    """Return rows of the joint states (n, arms, 6) of a CSV file, in rad and m.

    Raises:
        InvalidInput: the file is not such a table, there are too few rows, a value is missing, or values are so far
            outside their joint's range, or change so little, that unit, order or arm must be wrong.
    """
    values = _columns(path, manifest)[rows]
    if len(values) < 2:
        raise BadFile(path, f"has {len(values)} row(s) of joint states", "a recorded suture needs 2 or more")
    q = values.reshape(len(values), len(manifest.arms), 6) * manifest.units
    for number, (arm, of_arm) in enumerate(zip(manifest.models, q.swapaxes(0, 1), strict=True), start=1):
        _check_ranges(arm, of_arm, number, path)
    turned_rad = float(np.ptp(np.delete(q, INSERTION, axis=-1), 0).max())
    deepest_m = float(np.abs(q[..., INSERTION]).max())
    for little, found in (
        (turned_rad < MIN_TURN_RAD, f"no angle that changes by more than {shown(turned_rad, 'rad', '.2g')}"),
        (deepest_m < MIN_DEPTH_M, f"no insertion that exceeds {shown(deepest_m, 'm', '.2g')}"),
    ):
        if little:
            raise BadFile(path, f"has {found}, too little for a suture", f"check {UNITS}")
    return q


def _check_ranges(arm: ArmModel, q: NDArray[np.float64], number: int, path: Path) -> None:
    """Raise BadFile if a joint of an arm (n, 6) is missing or far out of range."""
    slack = BEYOND * (arm.upper - arm.lower)
    inside = (q >= arm.lower - slack) & (q <= arm.upper + slack)
    if not inside.all():
        row, i = np.argwhere(~inside)[0]
        joint = arm.joints[i]
        raise BadFile(
            path,
            f"has joint '{joint.name}' of {arm.name}, arm {number}, at {joint.shown(float(q[row, i]))} in row {row}, "
            f"outside [{joint.shown(joint.lower)}, {joint.shown(joint.upper)}]",
            f"check that row, the order of the columns, the arm and {UNITS}",
        )


def _columns(path: Path, manifest: Manifest) -> NDArray[np.float64]:
    """Return the joints' columns (n, 6 arms) of a CSV file, as recorded.

    Its header calls them ``q1`` to ``q6`` or by the arm's joint names (``yaw``, ...), with a prefix per arm if there
    are several (``psm1_yaw``), unless the manifest names them; other columns, such as times, are ignored.
    """
    arms = manifest.models
    joint_names = [joint.name for joint in arms[0].joints]
    prefix = "" if len(arms) == 1 else "psm1_"
    header, values = read_csv(path, ",".join(prefix + name for name in joint_names))
    if manifest.columns is not None:
        for column in manifest.columns:
            if column not in header:
                raise BadFile(path, f"has no column {column!r}", f"it has {', '.join(header)}")
        return values[:, [header.index(column) for column in manifest.columns]]
    for names in (joint_names, [f"q{i}" for i in range(1, 7)]):
        prefixes = [name.removesuffix(names[0]) for name in header if name.endswith(names[0])]
        prefixes = [each for each in prefixes if all(each + name in header for name in names)]
        if len(prefixes) == len(arms):
            return values[:, [header.index(each + name) for each in prefixes for name in names]]
    raise BadFile(
        path,
        f"has the columns {', '.join(header[:14])}",
        f"{len(arms)} arm(s) need six each, called {prefix}{joint_names[0]}, {prefix}{joint_names[1]}, ... "
        f"or {prefix}q1 to {prefix}q6, or named in the manifest",
    )
