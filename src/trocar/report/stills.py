"""Pictures of a trial for people, drawn by the simulator's ray camera from the trial's replay."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

from trocar.errors import InvalidInput
from trocar.eval import TaskReport
from trocar.eval.trial import Trial
from trocar.extras import how_to_install

if TYPE_CHECKING:
    from trocar.sim.offscreen import OffscreenCamera


def can_photograph() -> bool:
    """Return whether the simulator, which draws the pictures, is installed."""
    return find_spec("mujoco") is not None


def photographer_of(trial: Trial, report: TaskReport, scale: float = 1.0) -> OffscreenCamera:
    """Return an object that draws pictures of a trial, from the viewpoint and with the frame that its task defines.

    Args:
        trial: the trial.
        report: of its task.
        scale: of the pictures' width of 640 pixels.

    Raises:
        TrocarError: the simulator is not installed.
    """
    if not can_photograph():
        raise InvalidInput("pictures", "of a trial need mujoco", f"{how_to_install('sim')}")
    from trocar.sim.offscreen import OffscreenCamera  # an extra

    return OffscreenCamera(trial.replay(), report.view, report.colours, scale, report.frame(trial))
