"""Plots of quantities over time and of the motion of arms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from trocar.calibration.evaluation import Evaluation, wrist
from trocar.calibration.recording import Recording
from trocar.errors import InvalidInput
from trocar.eval.trial import Trial
from trocar.motion import MotionPlan, TimedPath
from trocar.motion.analysis import Derivatives
from trocar.registry import Registry
from trocar.report import style
from trocar.report.style import Picture, picture
from trocar.report.timechart import chart
from trocar.trajectory import Trajectory

DERIVATIVES = (("position", ""), ("velocity", "/s"), ("acceleration", "/s²"), ("jerk", "/s³"))
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
    grid = figure.subplots(3, len(paths), sharex=True, squeeze=False)
    for axes, (name, path) in zip(grid.T, paths.items(), strict=True):
        trajectory, passed = (path, []) if isinstance(path, Trajectory) else (path.trajectory, path.waypoint_times_s)
        count = trajectory.coefficients.shape[2]
        scales, unit = (ARM_SCALES, "deg") if count == 6 else (np.ones(count), "rad or m")
        names = joints or (ARM_NAMES if count == 6 else [f"joint {k + 1}" for k in range(count)])
        times_s = np.union1d(np.linspace(trajectory.times_s[0], trajectory.times_s[-1], SAMPLES), trajectory.times_s)
        labels = [f"{kind}, {unit}{per}" for kind, per in DERIVATIVES[:3]]
        _column(axes, times_s, [scales * trajectory(times_s, order) for order in range(3)], names, labels)
        for chart_axes in axes:
            for time_s in passed:
                chart_axes.axvline(time_s, color=style.QUIET, linewidth=0.7, linestyle=":")
        axes[0].set_title(f"{name}, {trajectory.duration_s:.3f} s" if name else f"{trajectory.duration_s:.3f} s")
        axes[0].legend(ncols=3, fontsize=7)


def draw_motion(parts: Mapping[str, tuple[Sequence[str], Derivatives]], path: str | Path) -> Path:
    """Draw joints and tip, each given by its signals' names and motion, as columns of four charts; return the path."""
    path = Path(path)
    with style.figure(5.2 * len(parts), 7.6, path) as figure:
        grid = figure.subplots(len(DERIVATIVES), len(parts), sharex=True, squeeze=False)
        for axes, (part, (names, found)) in zip(grid.T, parts.items(), strict=True):
            tip = part == "tip"
            times_s, rows = found.step_s * np.arange(len(found.position)), [getattr(found, k) for k, _ in DERIVATIVES]
            units = [f"m{per}" if tip else f"(rad or m){per}" if per else "rad or m" for _, per in DERIVATIVES]
            labels = [f"{kind}, {unit}" for (kind, _), unit in zip(DERIVATIVES, units, strict=True)]
            _column(axes, times_s, rows, names, labels, linewidth=0.8)
            axes[0].set_title("Tool tip in the arm's base frame" if tip else "Joints")
            axes[0].legend(ncols=6, fontsize=7)
    return path


def _column(
    column: Sequence[Axes],
    times_s: NDArray[np.floating],
    rows: Sequence[NDArray[np.float64]],
    names: Sequence[str],
    labels: Sequence[str],
    linewidth: float = 1.1,
) -> None:
    """Draw signals (n, joints) one below the other over time; a signal that ends earlier has fewer rows."""
    for axes, values, label in zip(column, rows, labels, strict=True):
        for k, name in enumerate(names):
            look = {"linewidth": linewidth, "color": style.SERIES[k % len(style.SERIES)]}
            axes.plot(times_s[: len(values)], values[:, k], label=name, **look)
        axes.set_ylabel(label)
    column[-1].set_xlabel("s")


PLOTS: Registry[Mapping[type, Callable[..., Picture]]] = Registry("plot", "trocar.plots")
"""Plots that tasks and packages add: types of values, each with a function that draws them."""


@singledispatch
def plot(thing: Any, **options: Any) -> Picture:
    """Return a picture of a value as a Matplotlib figure, which a notebook shows; nothing is written.

    >>> from trocar.report.plot import plot
    >>> plot(plan_through(arm, waypoints, limits))
    >>> plot(map, plan=plan).savefig("plan.png")

    Drawn are ``Trajectory``, ``TimedPath``, ``MotionPlan`` (option ``joints``: names), ``Recording``, ``Evaluation``,
    ``Trial`` (``title``), ``DexterityMap`` (``plan``, ``title``) and ``SuturePlan`` (``map``, ``title``).
    Your own package can add kinds with ``plot.register``, or as an entry point of the group ``trocar.plots``: a
    table of types and functions that draw them.

    Raises:
        TrocarError: values of this type have no picture.
    """
    for kinds in PLOTS.values():
        for kind, draw in kinds.items():
            plot.register(kind, draw)
    if plot.dispatch(type(thing)) is not plot.dispatch(object):
        return plot(thing, **options)
    kinds = ", ".join(sorted(kind.__name__ for kind in plot.registry if kind is not object))
    raise InvalidInput(f"{type(thing).__name__}", "has no picture", f"plot one of {kinds}")


@plot.register(Trajectory)
@plot.register(TimedPath)
def _path(thing: Trajectory | TimedPath, joints: tuple[str, ...] = ()) -> Picture:
    return picture(lambda figure: course(figure, {"": thing}, joints))


@plot.register(MotionPlan)
def _motion(thing: MotionPlan, joints: tuple[str, ...] = ()) -> Picture:
    if not thing.paths:
        raise InvalidInput("there", f"is no motion to plot: {thing.reason}")
    return picture(lambda figure: course(figure, thing.paths, joints))


@plot.register(Recording)
def _recording(thing: Recording) -> Picture:
    return picture(lambda figure: wrist(figure, thing))


@plot.register(Evaluation)
def _evaluation(thing: Evaluation) -> Picture:
    return picture(lambda figure: wrist(figure, thing.recording, thing))


@plot.register(Trial)
def _trial(thing: Trial, title: str = "Time chart") -> Picture:
    return picture(lambda figure: chart(figure, thing, title))
