"""``trocar study peg-transfer``: real trials on two workers, one of which is killed; then the same command again."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from typer.testing import CliRunner

from made_up_study import saved
from trocar.errors import TrocarError
from trocar.eval.study import opened
from trocar.eval.trial import trial_files
from trocar.tasks.peg_transfer.study.cells import cells_of
from trocar.tasks.peg_transfer.study.command import app

STUDY = "from trocar.tasks.peg_transfer.study.command import app; app()"
WORDS = ("--variants", "unilateral", "--methods", "uncalibrated", "--sessions", "2", "--transfers", "1", "--seed", "3")


def started(out, *more):
    return subprocess.Popen(
        [sys.executable, "-c", STUDY, *WORDS, "--out", str(out), *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def children_of(pid):
    """Return the processes that a process has started, with their command lines."""
    told = ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(pid)]
    lines = subprocess.run(told, capture_output=True, text=True, check=False).stdout.splitlines()
    return {int(line.split()[0]): line for line in lines}


def workers_of(process):
    """Return the processes that a study has started to run trials, by way of the one that they are forked from."""
    servers = [pid for pid, line in children_of(process.pid).items() if "forkserver" in line]
    return [pid for server in servers for pid in children_of(server)]


@pytest.mark.slow
def test_a_study_survives_the_death_of_a_worker_and_is_taken_up(tmp_path):
    process = started(tmp_path, "--jobs", "2", "--json")
    deadline = time.monotonic() + 120
    while not workers_of(process) and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(1.0)
    if not (workers := workers_of(process)):
        process.kill()
        pytest.fail(f"no worker was started: {process.communicate()[1]}")
    os.kill(workers[0], signal.SIGKILL)
    out, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    summary = json.loads(out)
    assert (summary["trials"], summary["transfers"]) == (2, 2)
    files = trial_files(tmp_path / "unilateral-uncalibrated")
    before = {file: (file.read_bytes(), file.stat().st_mtime_ns) for file in files}
    assert len(files) == 2
    again = run(*WORDS, "--out", tmp_path, "--jobs", 1, "--json")
    assert json.loads(again.stdout) == summary
    assert {file: (file.read_bytes(), file.stat().st_mtime_ns) for file in files} == before


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def test_the_report_alone_is_made_from_what_is_there(tmp_path):
    saved(tmp_path, sessions=2)
    told = ("--variants", "unilateral", "--methods", "calibrated,uncalibrated", "--sessions", 2, "--seed", 2)
    result = run(*told, "--out", tmp_path, "--report-only")
    assert result.exit_code == 0
    for words in (
        "Table II",
        "24 of 24",
        "12 of 24",
        "paper: surgeon",
        "H1 to H4",
        "raw data",
        "of the cell: recorded",
    ):
        assert words in result.output


def test_trials_come_session_by_session_and_only_those_that_lack(tmp_path):
    cells = saved(tmp_path, sessions=2)
    for cell in cells:
        (cell.folder / "session_01" / "trial_000.npz").unlink()
    more = cells_of(tmp_path, "unilateral", "calibrated,uncalibrated", sessions=3, seed=2)
    sessions, trials = opened(more)
    assert [(order.session, order.folder.name) for order in trials] == [
        (session, f"unilateral-{method}") for session in (1, 2) for method in ("calibrated", "uncalibrated")
    ]
    assert [order.session for order in sessions] == [1, 2]
    assert [len(order.runs) for order in sessions] == [2, 2]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--variants", "sideways"), "choose from unilateral"),
        (("--methods", "magic"), "choose from calibrated"),
        (("--jobs", "0"), "--jobs is 0"),
        (("--backend", "ray"), "processes, dask"),
        (("--sessions", "0"), "give 1 or more"),
        (("--report-only",), "does not exist; give that of a study with --out"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, words, said):
    result = run(*words, "--out", tmp_path / "study")
    assert isinstance(result.exception, TrocarError)
    assert said in str(result.exception)
