"""Run one trial of the peg transfer and print its score: python examples/first_trial.py [FOLDER]."""

import sys
from pathlib import Path

from trocar.report import write_report
from trocar.trials import Plan, prepare, run_trial, trial_file

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/example")
folder.mkdir(parents=True, exist_ok=True)

plan = Plan(task="peg-transfer", method="calibrated", model="play", trials=1, seed=1)
session, models = prepare(plan, folder)  # record the random motion in this cell, fit the cables
trial = run_trial(plan, session, models, index=0, pictures=True)
trial.save(trial_file(folder, 0))

for transfer in trial.transfers:
    outcome = "done" if transfer["succeeded"] else transfer["failure"]
    print(f"peg {transfer['source']:>2} to {transfer['target']:>2}: {outcome}")
summary, files = write_report(folder, [trial])
print(f"{summary['succeeded']} of {summary['attempted']} in {summary['mean_time_s']:.2f} s each; see {files[1]}")
