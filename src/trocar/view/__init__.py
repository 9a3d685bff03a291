"""Trials in three dimensions, in the browser (extra ``view``)."""

from trocar.view.replay import write_replay
from trocar.view.trial_view import TrialView, show_replay

__all__ = ["TrialView", "show_replay", "write_replay"]
