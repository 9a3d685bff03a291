"""Joints of one arm: desired, commanded, measured and true, and how they differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput
from trocar.replay import Replay

KINDS = ("desired", "commanded", "measured", "true")
PRISMATIC = 2
"""Yaw, pitch, insertion, roll, wrist pitch, wrist yaw, jaw: ``ArmModel`` has its third joint slide."""

WINDOW_S = 5.0
"""Time before and after the present that is drawn."""

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
        """Return seconds from a tick's time (k,), and the difference (k,) of each of :meth:`compared`, deg or mm."""
        now = self.times_s[tick]
        first, last = np.searchsorted(self.times_s, [now - WINDOW_S, now + WINDOW_S])
        ticks = np.arange(first, last, max(1, (last - first) // POINTS))
        reference = self.values[self.reference][ticks, joint]
        return (self.times_s[ticks] - now, *(self.values[kind][ticks, joint] - reference for kind in self.compared()))


def unit(joint: int) -> str:
    """Return the unit in which a joint, counted from 0, is shown."""
    return "mm" if joint == PRISMATIC else "deg"


SCALE = np.where(np.arange(7) == PRISMATIC, 1e3, 180 / np.pi)
"""Factors from m and rad to the units shown."""
