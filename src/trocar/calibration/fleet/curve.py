"""How well a model predicts as a function of the number of rows it was fitted on, with a prior and without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.figure import COLOURS, JOINT_TITLES
from trocar.calibration.fleet.fit import fit_from_prior
from trocar.calibration.fleet.prior import FleetPrior
from trocar.calibration.models.base import MIN_ROWS
from trocar.calibration.models.play import PlayModel
from trocar.calibration.recording import Recording
from trocar.errors import InvalidInput
from trocar.files.output import write_figure

TAIL_SHARE = 0.2
"""Errors count on this last share of a recording."""
USUAL_ROWS = (50, 75, 100, 150, 200, 300, 500, 800)
WITH, WITHOUT = "from the prior", "without a prior"


@dataclass(frozen=True, eq=False)
class Curve:
    """RMSE as a function of the number of rows that a fit may use.

    Attributes:
        recording: its name.
        rows: (k,) first rows that are fitted on.
        seconds: (k,) how long they took on the robot.
        rmse: by kind of fit, (k, 6) on the tail, rad and m (q3).
        tail: rows that are scored.
    """

    recording: str
    rows: tuple[int, ...]
    seconds: tuple[float, ...]
    rmse: dict[str, NDArray[np.float64]]
    tail: int


def curve(recording: Recording, prior: FleetPrior, rows: Sequence[int] | None = None) -> Curve:
    """Return the errors on the last fifth of a recording, by how many of its first rows were fitted on.

    Args:
        recording: of one instrument.
        prior: preferably one that has not seen it.
        rows: numbers of first rows; None: the usual ones that there are.

    Raises:
        TrocarError: numbers of rows that leave nothing to fit or to score on.
    """
    cut = round((1.0 - TAIL_SHARE) * len(recording))
    chosen = tuple(rows) if rows is not None else (*(n for n in USUAL_ROWS if n < cut), cut)
    for n in chosen:
        if not MIN_ROWS <= n <= cut:
            raise InvalidInput(
                f"{n} rows", f"are outside {MIN_ROWS}..{cut}: {recording.name} is scored from row {cut} on"
            )
    held = recording.scored(cut)
    rmse: dict[str, list[NDArray[np.float64]]] = {WITH: [], WITHOUT: []}
    for n in chosen:
        part = recording.first(n)
        models = {WITH: fit_from_prior(part, prior), WITHOUT: PlayModel.fit(part, np.random.default_rng(0))}
        for way, model in models.items():
            error = (model.predict(recording.q_cmd) - recording.q_phy)[held.valid]
            rmse[way].append(np.sqrt(np.mean(error**2, axis=0)))
    seconds = tuple(float(recording.t_s[n - 1] - recording.t_s[0]) for n in chosen)
    found = {way: np.array(values) for way, values in rmse.items()}
    return Curve(recording.name, chosen, seconds, found, int(held.valid.sum()))


def draw_curve(found: Curve, path: str | Path) -> Path:
    """Draw the errors of the wrist's joints over the time of recording; return the path of the picture."""
    from matplotlib.figure import Figure  # slow to import, and only this picture needs it

    figure = Figure(figsize=(12, 4), layout="constrained", dpi=110)
    for axis, joint in zip(figure.subplots(1, 3), (3, 4, 5), strict=True):
        for (way, values), colour in zip(found.rmse.items(), (COLOURS["predicted"], COLOURS["measured"]), strict=True):
            axis.plot(found.seconds, values[:, joint], "o-", ms=4, color=colour, label=way)
        axis.set(xscale="log", title=JOINT_TITLES[joint], xlabel="time of recording [s]", ylim=(0, None))
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    figure.axes[0].set_ylabel("RMSE on the last fifth [rad]")
    figure.axes[0].legend()
    figure.suptitle(f"{found.recording}: error by length of the recording")
    return write_figure(path, figure)
