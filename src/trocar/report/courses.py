"""A trajectory over time: position, velocity and acceleration of each joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from trocar.motion import TimedPath
from trocar.report import style
from trocar.trajectory import Trajectory

COLOURS = (style.BLUE, style.VERMILION, style.GREEN, style.ORANGE, style.PURPLE, style.SKY)
ORDERS = ("position", "velocity", "acceleration")
PER = ("", "/s", "/s²")
ARM_NAMES = ("yaw", "pitch", "insertion (mm)", "roll", "wrist pitch", "wrist yaw")
ARM_SCALES = np.where(np.arange(6) == 2, 1e3, np.degrees(1.0))
"""Factors that convert an arm's joints to mm and deg."""
SAMPLES = 400


def course(figure: Figure, paths: Mapping[str, TimedPath | Trajectory], joints: Sequence[str] = ()) -> None:
    """Draw each trajectory as a column of three charts; dotted lines show when it passes its waypoints.

    Six joints are assumed to be an arm's and shown in deg, the insertion in mm; others are shown as they are, in rad or
    m.

    Args:
        figure: empty.
        paths: by name, the title of the column.
        joints: their names; none: those of an arm, or numbers.
    """
    figure.set_size_inches(max(7.0, 5.2 * len(paths)), 6.6)
    grid = figure.subplots(len(ORDERS), len(paths), sharex=True, squeeze=False)
    for column, (name, path) in enumerate(paths.items()):
        trajectory, passed = (path, []) if isinstance(path, Trajectory) else (path.trajectory, path.waypoint_times_s)
        count = trajectory.coefficients.shape[2]
        scales, unit = (ARM_SCALES, "deg") if count == 6 else (np.ones(count), "rad or m")
        names = joints or (ARM_NAMES if count == 6 else [f"joint {k + 1}" for k in range(count)])
        times_s = np.union1d(np.linspace(trajectory.times_s[0], trajectory.times_s[-1], SAMPLES), trajectory.times_s)
        for order, axes in enumerate(grid[:, column]):
            _lines(axes, times_s, scales * trajectory(times_s, order), names)
            for time_s in passed:
                axes.axvline(time_s, color=style.QUIET, linewidth=0.7, linestyle=":")
            axes.set_ylabel(f"{ORDERS[order]}, {unit}{PER[order]}")
        grid[0, column].set_title(
            f"{name}, {trajectory.duration_s:.3f} s" if name else f"{trajectory.duration_s:.3f} s"
        )
        grid[0, column].legend(ncols=3, fontsize=7)
        grid[-1, column].set_xlabel("s")


def _lines(axes: Axes, times_s: NDArray[np.float64], values: NDArray[np.float64], names: Sequence[str]) -> None:
    for k, name in enumerate(names):
        axes.plot(times_s, values[:, k], linewidth=1.1, color=COLOURS[k % len(COLOURS)], label=name)
