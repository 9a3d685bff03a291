"""The joints of an arm beside a scene: all as a table, one as curves of its errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput
from trocar.replay import Replay
from trocar.view.stage import Rgb, css
from trocar.view.timeline import WINDOW_S

if TYPE_CHECKING:
    from viser import GuiApi

KINDS = ("desired", "commanded", "measured", "true")
PRISMATIC = 2  # yaw, pitch, insertion, roll, wrist pitch, wrist yaw, jaw: ``ArmModel`` has its third joint slide
SCALE = np.where(np.arange(7) == PRISMATIC, 1e3, 180 / np.pi)  # from m and rad to mm and deg
POINTS = 250  # of a curve, maximum


@dataclass(frozen=True, eq=False)
class Joints:
    """Joints of one arm in degrees, the insertion in mm.

    Attributes:
        names: seven.
        times_s: (n,).
        values: (n, 7) of each available one of ``KINDS``.
        reference: the one of ``KINDS`` with which the others are compared.
    """

    names: tuple[str, ...]
    times_s: NDArray[np.float64]
    values: dict[str, NDArray[np.float64]]
    reference: str

    @staticmethod
    def of(replay: Replay, arm: str) -> Joints | None:
        """Return the joints of an arm, or None if the replay has none.

        Raises:
            TrocarError: an array has another shape than (n, 7).
        """
        given = replay.joints.get(arm, {})
        kinds = [kind for kind in KINDS if kind in given]
        if not kinds:
            return None
        shape = (len(replay.times_s), 7)
        for kind in kinds:
            if given[kind].shape != shape:
                raise InvalidInput(f"the {kind} joints", f"of '{arm}' have shape {given[kind].shape}", f"give {shape}")
        names = replay.joint_names.get(arm, tuple(f"joint {k + 1}" for k in range(7)))
        return Joints(names, replay.times_s, {kind: given[kind] * SCALE for kind in kinds}, kinds[0])

    def table(self, tick: int) -> str:
        """Return the joints at a tick in Markdown, with the last kind's error against the reference."""
        kinds = list(self.values)
        error = kinds[-1] if len(kinds) > 1 else None
        heads = ["joint", *kinds, *([f"{error} - {self.reference}"] if error else [])]
        rows = [f"| {' | '.join(heads)} |", "|:--" + "|--:" * (len(heads) - 1) + "|"]
        for k, name in enumerate(self.names):
            numbers = [f"{self.values[kind][tick, k]:.1f}" for kind in kinds]
            if error:
                numbers.append(f"**{self.values[error][tick, k] - self.values[self.reference][tick, k]:+.2f}**")
            rows.append(f"| {name.replace('_', ' ')}, {unit(k)} | {' | '.join(numbers)} |")
        return "\n".join(rows)

    def compared(self) -> tuple[str, ...]:
        """Return the kinds that are compared with the reference."""
        return tuple(kind for kind in self.values if kind != self.reference)

    def errors_near(self, tick: int, joint: int) -> tuple[NDArray[np.float64], ...]:
        """Return times (k,) in s from a tick, and for each of :meth:`compared` its error (k,), deg or mm."""
        now = self.times_s[tick]
        first, last = np.searchsorted(self.times_s, [now - WINDOW_S, now + WINDOW_S])
        ticks = np.arange(first, last, max(1, (last - first) // POINTS))
        reference = self.values[self.reference][ticks, joint]
        return (self.times_s[ticks] - now, *(self.values[kind][ticks, joint] - reference for kind in self.compared()))


def unit(joint: int) -> str:
    """Return the unit in which a joint, counted from 0, is shown."""
    return "mm" if joint == PRISMATIC else "deg"


CURVES: Mapping[str, Rgb] = {"commanded": (40, 120, 255), "measured": (214, 60, 160), "true": (95, 215, 40)}


class JointsPanel:
    """One joint's errors as curves, up to ``ahead_s`` after the present, and all joints as a table."""

    def __init__(self, gui: GuiApi, joints: Joints, ahead_s: float = WINDOW_S) -> None:
        self._joints, self._tick = joints, 0
        if joints.compared():
            self._menu = gui.add_dropdown("joint", joints.names, initial_value=joints.names[-2])
            looks: list[Any] = [{"label": kind, "stroke": css(CURVES[kind]), "width": 2} for kind in joints.compared()]
            scales: dict[str, Any] = {"x": {"time": False, "range": (-WINDOW_S, ahead_s)}}
            data = joints.errors_near(0, len(joints.names) - 2)
            self._curves = gui.add_uplot(data, ({"label": "s from now"}, *looks), scales=scales, height=170)
            self._menu.on_update(lambda _: self._draw_curves())
        self._table = gui.add_markdown("")
        self.show(0)

    def show(self, tick: int) -> None:
        """Show a tick."""
        self._tick = tick
        self._table.content = self._joints.table(tick)
        if self._joints.compared():
            self._draw_curves()

    def renew(self, joints: Joints) -> None:
        """Take new samples of the same kinds, and show the last one."""
        self._joints = joints
        self.show(len(joints.times_s) - 1)

    def _draw_curves(self) -> None:
        joint = self._joints.names.index(self._menu.value)
        self._curves.title = f"{self._menu.value}: difference from {self._joints.reference}, {unit(joint)}"
        self._curves.data = self._joints.errors_near(self._tick, joint)


def add_joints(gui: GuiApi, replay: Replay, ahead_s: float = WINDOW_S) -> dict[str, JointsPanel]:
    """Add a tab for each arm whose joints a replay has; return their panels by arm."""
    tabs, found = gui.add_tab_group(), {}
    for arm in replay.joints:
        joints = Joints.of(replay, arm)
        if joints is not None:
            with tabs.add_tab(arm):
                found[arm] = JointsPanel(gui, joints, ahead_s)
    return found
