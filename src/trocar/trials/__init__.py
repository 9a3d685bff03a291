"""Trials: run (``trocar.trials.run``, which needs the simulator), kept, loaded."""

from trocar.trials.folder import load_trials, open_folder
from trocar.trials.trial import Trial, trial_file, trial_files

__all__ = ["Trial", "load_trials", "open_folder", "trial_file", "trial_files"]
