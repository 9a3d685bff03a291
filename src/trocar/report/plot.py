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


KINDS = (("position", ""), ("velocity", "/s"), ("acceleration", "/s²"), ("jerk", "/s³"))


def draw_motion(parts: Mapping[str, tuple[Sequence[str], Derivatives]], path: str | Path) -> Path:
    """Draw each part (joints, tip) as a column of four charts, and return the path.

    Args:
        parts: name to the signals' names and their motion.
        path: of the picture.
    """
    path = Path(path)
    with style.figure(5.2 * len(parts), 7.6, path) as figure:
        grid = figure.subplots(len(KINDS), len(parts), sharex=True, squeeze=False)
        for column, (part, (names, found)) in enumerate(parts.items()):
            times_s = found.step_s * np.arange(len(found.position))
            unit = "m" if part == "tip" else "rad or m"
            for axes, (kind, per) in zip(grid[:, column], KINDS, strict=True):
                rows = getattr(found, kind)
                for k, name in enumerate(names):
                    axes.plot(times_s[: len(rows)], rows[:, k], linewidth=0.8, color=COLOURS[k % 6], label=name)
                axes.set_ylabel(f"{kind}, {f'({unit}){per}' if per and part != 'tip' else unit + per}")
            grid[0, column].set_title("Tool tip in the arm's base frame" if part == "tip" else "Joints")
            grid[0, column].legend(ncols=6, fontsize=7)
            grid[-1, column].set_xlabel("s")
    return path


PLOTS: Registry[Mapping[type, Callable[..., Picture]]] = Registry("plot", "trocar.plots")
"""Pictures of values that belong to a task: its types, each with a function that draws it."""


@singledispatch
def plot(thing: Any, **options: Any) -> Picture:
    """Return a picture of a value as a Matplotlib figure, which a notebook shows; nothing is written.

    >>> from trocar.report.plot import plot
    >>> plot(plan_through(arm, waypoints, limits))
    >>> plot(map, plan=plan).savefig("plan.png")

    | of a | is drawn | options |
    |---|---|---|
    | ``Trajectory``, ``TimedPath``, ``MotionPlan`` | position, velocity, acceleration over time | ``joints``: names |
    | ``Recording`` | commanded and measured wrist over time, and its hysteresis | |
    | ``Evaluation`` | the same, with what the cable model predicted | |
    | ``Trial`` | the time chart of its arms | ``title`` |
    | ``DexterityMap`` | dexterity round the circle | ``plan``: the ``SuturePlan`` to draw on it; ``title`` |
    | ``SuturePlan`` | its sutures on the circle | ``map``: the ``DexterityMap`` that it was made from; ``title`` |

    Your own package can add kinds with ``plot.register``, or as an entry point of the group ``trocar.plots``: a
    table of types and functions that draw them.

    Args:
        thing: to be drawn.
        options: as in the table.

    Raises:
        TrocarError: it has no picture.
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
