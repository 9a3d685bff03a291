"""Trials in three dimensions, in the browser (extra ``view``)."""

from trocar.view.replay import write_replay
from trocar.view.trial_view import TrialView

__all__ = ["TrialView", "write_replay"]
