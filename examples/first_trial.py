"""Run one trial of the peg transfer and print its score: python examples/first_trial.py [FOLDER] [TRANSFERS]."""

import sys
from pathlib import Path

from trocar.eval import TASKS
from trocar.eval.config import RunConfig
from trocar.eval.folder import load_trials, open_folder
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.eval.trial import trial_file
from trocar.report.files import write_report

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/example")
transfers = int(sys.argv[2]) if len(sys.argv) > 2 else 12

task = TASKS["peg-transfer"](transfers=transfers)
config = RunConfig(task, method="calibrated", model="play", sessions=1, trials=1, seed=1)
for session, index in open_folder(config, folder):  # trials not in the folder yet
    prepared = prepare(config, session, folder)  # draw a session, record a random motion in it, fit the cables
    run_trial(config, prepared, index).save(trial_file(folder, session, index))

trials, _ = load_trials(folder)
for score in trials[0].scores:
    outcome = "done" if score["succeeded"] else score["failure"]
    print(f"peg {score['source']:>2} to {score['target']:>2}: {outcome}")
summary, files = write_report(folder, trials)
print(f"{summary['succeeded']} of {summary['attempted']} in {summary['mean_time_s']:.2f} s each; see {files[-1]}")
