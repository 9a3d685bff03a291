"""Trials: run, kept, loaded."""

from trocar.trials.log import Computation, Span, TrialLog
from trocar.trials.run import METHODS, Plan, open_folder, prepare, run_trial, versions
from trocar.trials.trial import Trial, trial_file

__all__ = [
    "METHODS",
    "Computation",
    "Plan",
    "Span",
    "Trial",
    "TrialLog",
    "open_folder",
    "prepare",
    "run_trial",
    "trial_file",
    "versions",
]
