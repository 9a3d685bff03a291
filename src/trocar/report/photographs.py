"""Pictures of a trial for people, drawn by the simulator's ray camera from the trial's replay."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

from trocar.errors import TrocarError
from trocar.extras import how_to_install
from trocar.tasks.kit import TaskReport
from trocar.trials.trial import Trial

if TYPE_CHECKING:
    from trocar.sim.photograph import Photographer


def can_photograph() -> bool:
    """Return whether there is a simulator here, whose rays draw the pictures."""
    return find_spec("mujoco") is not None


def photographer_of(trial: Trial, report: TaskReport, scale: float = 1.0) -> Photographer:
    """Return who draws pictures of a trial, from where and as large as its task wants them.

    Args:
        trial: which.
        report: of its task.
        scale: of the pictures' 640 pixels from left to right.

    Raises:
        TrocarError: there is no simulator here.
    """
    if not can_photograph():
        raise TrocarError(f"pictures of a trial need mujoco; {how_to_install('sim')}")
    from trocar.sim.photograph import Photographer  # noqa: PLC0415 (an extra)

    return Photographer(trial.replay(), report.view, report.colours, scale, report.frame(trial))
