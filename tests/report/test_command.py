"""The command printed in a report repeats the same run."""

import shlex

import pytest
import typer
from typer.testing import CliRunner

from trocar.cli import app
from trocar.eval import TASKS
from trocar.eval import folder as trials_folder
from trocar.report.run_page import command_of

RUNS = [
    *(f"run {name} --seed 4" for name in TASKS),
    "run peg-transfer --variant handover --transfers 3 --method optimized --model ridge --calibration joints "
    "--new-session --refit-offsets --flawless-camera --difficulty harsh --flaw offsets=2deg --flaw wear=0 "
    "--sessions 3 --trials 2",
    "run peg-transfer --method adaptive --planner sqp --budget 90",
    "run suture --sutures 3 --direction clockwise --calibration joints --prior fleet",
    "run debridement --arms 1 --fragments 4 --method paper --backdrop tissue --flaw kinematics=0.5",
]


@pytest.fixture
def config_of(monkeypatch):
    """Return what a line asks for, without running it."""

    def read(line):
        found = []

        def stop(config, folder):
            found.append(config)
            raise typer.Exit(0)

        monkeypatch.setattr(trials_folder, "open_folder", stop)
        result = CliRunner().invoke(app, shlex.split(line))
        assert result.exit_code == 0, result.exception
        return found[0]

    return read


@pytest.mark.parametrize("line", RUNS)
def test_it_makes_the_same_run(config_of, line):
    asked = config_of(line)
    command = command_of(asked.about(), asked.sessions, asked.trials)
    assert command.startswith("trocar run ")
    again = config_of(command.removeprefix("trocar "))
    assert again.about() == asked.about()
    assert (again.sessions, again.trials) == (asked.sessions, asked.trials)


def test_files_that_were_given_are_named_as_such(config_of):
    about = config_of(RUNS[0]).about() | {"plugins": ["3f2a"], "station": "mine", "prior": "mine.npz", "task": "own"}
    command = command_of(about, 1, 1)
    assert "--plugin FILE" in command and "--station FILE" in command and "--prior FILE" in command
