"""One function for pictures on the screen: ``plot(thing)`` draws whatever has a picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import singledispatch
from typing import Any

from trocar.calibration.evaluation import Evaluation
from trocar.calibration.figure import wrist
from trocar.calibration.recording import Recording
from trocar.errors import InvalidInput
from trocar.eval.trial import Trial
from trocar.motion import MotionPlan, TimedPath
from trocar.registry import Registry
from trocar.report.courses import course
from trocar.report.style import Picture, picture
from trocar.report.timechart import chart
from trocar.trajectory import Trajectory

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
