"""What was requested of real arms, sent to them, and read from them, tick by tick."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trocar.cell import Robot
from trocar.hardware.messages import Report
from trocar.robots.driver import TICK_S


class HardwareRecord:
    """One row per tick of the loop; the true joints of real arms are not known.

    Attributes:
        asked_of: the outermost robot, whose set-points are what the script requested.
    """

    def __init__(self, arms: Sequence[str]):
        self.asked_of: Robot | None = None
        self._times: list[float] = []
        self._rows: dict[str, list[NDArray[np.float64]]] = {name: [] for name in arms}

    def take(self, report: Report) -> None:
        """Add the row of a tick."""
        if self.asked_of is None:
            return
        self._times.append(report.time_s)
        for name, arm in report.arms.items():
            asked = self.asked_of.setpoint(name).q
            reading = arm.reading
            self._rows[name].append(np.concatenate([asked, arm.sent[6:], arm.sent, reading.q, [reading.jaw_rad]]))

    def arrays(self, origin_s: float, lead_s: float) -> dict[str, NDArray[np.float64]]:
        """Return (n, 7) ``desired_ARM``, ``commanded_ARM`` and ``measured_ARM`` at 100 Hz: joints and jaw.

        A row has what was last sent and read by its time, so late ticks leave no gap. The last row has the last report.

        Args:
            origin_s: the machine's monotonic clock at the first row.
            lead_s: how far the requested set-points are ahead of those sent.
        """
        times_s = np.array(self._times) - origin_s
        if not len(times_s):
            kinds = ("desired", "commanded", "measured")
            return {f"{kind}_{name}": np.zeros((0, 7)) for kind in kinds for name in self._rows}
        grid_s = TICK_S * np.arange(math.ceil(max(times_s[-1], 0.0) / TICK_S - 1e-9) + 1)
        now = np.clip(np.searchsorted(times_s, grid_s, side="right") - 1, 0, None)
        asked = np.clip(np.searchsorted(times_s + lead_s, grid_s, side="right") - 1, 0, None)
        found = {}
        for name, rows in self._rows.items():
            table = np.array(rows)
            found[f"desired_{name}"] = np.column_stack([table[asked, :6], table[now, 6]])
            found[f"commanded_{name}"], found[f"measured_{name}"] = table[now, 7:14], table[now, 14:]
        return found
