"""Plans and trials in three dimensions, in the browser (extra ``view``)."""

from trocar.view.replay import write_replay
from trocar.view.suture import SutureView, show_plan
from trocar.view.trial_view import TrialView, show_replay

__all__ = ["SutureView", "TrialView", "show_plan", "show_replay", "write_replay"]
