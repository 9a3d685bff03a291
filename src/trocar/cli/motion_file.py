"""Planned motions in a file, sample by sample: CSV, JSON or npz."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trocar.errors import TrocarError
from trocar.files.archive import Archive
from trocar.files.output import require_place, write_json, write_table
from trocar.trajectory import Trajectory

KIND = "trocar motion"
SUFFIXES = (".csv", ".json", ".npz")
ORDERS = ("position", "velocity", "acceleration")


def columns_of(joints: Sequence[str]) -> list[str]:
    """Return the names of the columns: which motion, when, then each joint's position, velocity, acceleration."""
    return ["motion", "t_s", *(f"{joint}_{order}" for joint in joints for order in ORDERS)]


def require_motion_file(path: Path, joints: Sequence[str], inputs: Sequence[Path]) -> None:
    """Raise TrocarError unless motions can be written there: ask before they are planned."""
    if path.suffix not in SUFFIXES:
        raise TrocarError(f"file {str(path)!r} must end in {', '.join(SUFFIXES)}; choose another name")
    require_place(path, KIND, inputs, mark=",".join(columns_of(joints)) if path.suffix == ".csv" else "")


def write_motions(path: Path, motions: Sequence[Trajectory], joints: Sequence[str], step_s: float) -> Path:
    """Write motions, each sampled from 0 s to its end, and return the path.

    Args:
        path: ends in ``.csv`` (``motion``, ``t_s``, columns ``JOINT_position`` and so on), ``.json`` (``motions``, each
            with ``t_s`` (n,), ``position``, ``velocity``, ``acceleration`` (n, joints)) or ``.npz`` (the arrays of all
            motions one after the other, and ``motion`` (n,), the number of each sample's).
        motions: in order.
        joints: names; rad and m.
        step_s: between samples; the last step may be shorter.
    """
    sampled = []
    for motion in motions:
        times = np.append(np.arange(0.0, motion.duration_s, step_s), motion.duration_s)
        sampled.append((times, *(motion(motion.times_s[0] + times, order) for order in range(len(ORDERS)))))
    if path.suffix == ".json":
        told = [dict(zip(("t_s", *ORDERS), (array.tolist() for array in one), strict=True)) for one in sampled]
        return write_json(path, {"joints": list(joints), "motions": told}, KIND)
    numbers = np.concatenate([np.full(len(one[0]), number) for number, one in enumerate(sampled)])
    times, *moved = (np.concatenate(arrays) for arrays in zip(*sampled, strict=True))
    if path.suffix == ".npz":
        header = {"format": KIND, "version": 1, "joints": list(joints)}
        arrays = dict(zip(ORDERS, moved, strict=True))
        return Archive(header, {"motion": numbers, "t_s": times, **arrays}).save(path)
    by_joint = np.stack(moved, axis=-1).reshape(len(times), -1)
    rows = (
        [str(number), *(f"{value:.9g}" for value in (time_s, *row))]
        for number, time_s, row in zip(numbers, times, by_joint, strict=True)
    )
    return write_table(path, columns_of(joints), rows)
