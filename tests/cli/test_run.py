"""``trocar run`` and ``trocar report``: what they print, keep, take up again and refuse."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from synthetic import synthetic_trial
from trocar import trials as trials_package
from trocar.report import load_trials, run_files, summarise
from trocar.trials import trial_file

SHORT = "import trocar.tasks.peg_transfer as task; task.THERE = ((1, 7),); from trocar.cli import main; main()"
"""The command line with two transfers a trial instead of twelve: peg 1 to 7 and back."""


@pytest.fixture
def played(monkeypatch):
    """Replace trials by synthetic ones without pictures; return the list of those that were played."""
    done = []

    def run_trial(plan, session, models, index, listener=None, pictures=False):
        done.append(index)
        return synthetic_trial(plan, index)

    monkeypatch.setattr(trials_package, "prepare", lambda plan, folder: (None, {}))
    monkeypatch.setattr(trials_package, "run_trial", run_trial)
    monkeypatch.setattr(run_files, "_pictures", lambda folder, trials: [])
    return done


def summary_of(folder: Path):
    return json.loads((folder / "summary.json").read_text())


def test_json_is_one_object_equal_to_the_summary(trocar, played, tmp_path):
    code, out, _ = trocar("run", "peg-transfer", "--trials", 2, "--seed", 5, "--out", tmp_path / "run", "--json")
    assert code == 0
    assert out.count("\n") == 1
    assert json.loads(out) == summary_of(tmp_path / "run") == summarise(load_trials(tmp_path / "run"))
    assert json.loads(out)["seed"] == 5
    assert played == [0, 1]


def test_the_table_names_task_figures_and_files(trocar, played, tmp_path):
    code, out, _ = trocar("run", "peg-transfer", "--out", tmp_path / "run")
    assert code == 0
    for words in ("5.0", "collisions a trial", "real time", "summary.json", "took longer"):
        assert words in out


def test_the_default_folder_is_named_after_the_run(trocar, played, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    trocar("run", "peg-transfer", "--method", "uncalibrated", "--seed", 8)
    assert (tmp_path / "out" / "peg-transfer-uncalibrated-8" / "trial_000.npz").is_file()


def test_finished_trials_are_not_played_again(trocar, played, tmp_path):
    words = ("run", "peg-transfer", "--trials", 3, "--out", tmp_path, "--json")
    first = trocar(*words)[1]
    trial_file(tmp_path, 1).unlink()
    played.clear()
    code, out, _ = trocar(*words)
    assert (code, played) == (0, [1])
    assert json.loads(out) == json.loads(first)
    played.clear()
    code, out, _ = trocar(*words)
    assert (code, played) == (0, [])
    assert json.loads(out) == json.loads(first)


def test_another_plan_in_the_same_folder_is_refused(trocar, played, tmp_path):
    trocar("run", "peg-transfer", "--out", tmp_path, "--json")
    played.clear()
    code, out, err = trocar("run", "peg-transfer", "--seed", 1, "--out", tmp_path, "--json")
    assert (code, out, played) == (2, "", [])
    assert err.count("\n") == 1 and "another run" in err
    assert summary_of(tmp_path)["seed"] == 0


def interrupt_at(monkeypatch, number, error=KeyboardInterrupt):
    def run_trial(plan, session, models, index, listener=None, pictures=False):
        if index == number:
            raise error
        return synthetic_trial(plan, index)

    monkeypatch.setattr(trials_package, "run_trial", run_trial)


def test_ctrl_c_keeps_finished_trials_and_says_so(trocar, played, monkeypatch, tmp_path):
    interrupt_at(monkeypatch, 1)
    code, out, _ = trocar("run", "peg-transfer", "--trials", 3, "--out", tmp_path)
    assert code == 130
    assert "finished trials kept: 1" in out.replace("\n", " ")
    assert summary_of(tmp_path)["trials"] == 1
    assert not list(tmp_path.glob(".*part"))
    interrupt_at(monkeypatch, None)
    code, out, _ = trocar("run", "peg-transfer", "--trials", 3, "--out", tmp_path, "--json")
    assert code == 0
    assert json.loads(out)["trials"] == 3


def test_ctrl_c_before_the_first_trial_leaves_no_summary(trocar, played, monkeypatch, tmp_path):
    interrupt_at(monkeypatch, 0)
    code, out, err = trocar("run", "peg-transfer", "--out", tmp_path, "--json")
    assert code == 130
    assert out == ""
    assert "before the first trial" in err
    assert not (tmp_path / "summary.json").exists()


def test_a_report_writes_the_same_summary_and_plays_nothing(trocar, played, tmp_path):
    trocar("run", "peg-transfer", "--trials", 2, "--out", tmp_path)
    before = (tmp_path / "summary.json").read_bytes()
    (tmp_path / "summary.json").unlink()
    played.clear()
    code, out, _ = trocar("report", tmp_path, "--json")
    assert (code, played) == (0, [])
    assert (tmp_path / "summary.json").read_bytes() == before
    assert json.loads(out) == json.loads(before)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("run", "knitting"), "peg-transfer"),
        (("run", "peg-transfer", "--variant", "sideways"), "unilateral"),
        (("run", "peg-transfer", "--method", "magic"), "uncalibrated, calibrated"),
        (("run", "peg-transfer", "--model", "oracle"), "play"),
        (("run", "peg-transfer", "--trials", "0"), "--trials"),
        (("run", "peg-transfer", "--seed", "-4"), "--seed"),
        (("run", "peg-transfer", "--method", "uncalibrated", "--refit-offsets"), "--refit-offsets"),
        (("report", "nowhere"), "nowhere"),
        (("report", "."), "trial_*.npz"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(trocar, tmp_path, monkeypatch, words, named):
    monkeypatch.chdir(tmp_path)
    code, out, err = trocar(*words, "--json")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1 and named in err
    assert list(tmp_path.iterdir()) == []


def test_a_broken_trial_is_named_by_report(trocar, played, tmp_path):
    trocar("run", "peg-transfer", "--trials", 2, "--out", tmp_path)
    path = trial_file(tmp_path, 1)
    path.write_bytes(path.read_bytes()[:500])
    code, out, err = trocar("report", tmp_path, "--json")
    assert (code, out) == (2, "")
    assert str(path) in err


def test_a_real_ctrl_c_in_a_running_trial_ends_it_without_a_traceback(tmp_path):
    words = ["run", "peg-transfer", "--trials", "50", "--method", "uncalibrated", "--out", str(tmp_path), "--json"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        [sys.executable, "-c", SHORT, *words],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        deadline = time.monotonic() + 120
        while not trial_file(tmp_path, 0).is_file() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    kept = len(list(tmp_path.glob("trial_*.npz")))
    assert kept >= 1
    assert json.loads(out)["trials"] == summary_of(tmp_path)["trials"] == kept
    assert not list(tmp_path.glob(".*part"))


def in_a_process(folder: Path, hash_seed: str, *options: str) -> dict:
    words = ["run", "peg-transfer", "--seed", "21", "--model", "offset", "--out", str(folder), "--json", *options]
    result = subprocess.run(
        [sys.executable, "-c", SHORT, *words],
        env={**os.environ, "PYTHONHASHSEED": hash_seed, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert result.returncode == 0, result.stderr
    assert "Traceback" not in result.stderr
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def two_processes(tmp_path_factory):
    folders = [tmp_path_factory.mktemp(name) for name in ("first", "second")]
    return folders, [in_a_process(folder, seed) for folder, seed in zip(folders, ("1", "2"), strict=True)]


def test_the_same_seed_writes_the_same_bytes_in_another_process(two_processes):
    (first, second), _ = two_processes
    assert trial_file(first, 0).read_bytes() == trial_file(second, 0).read_bytes()


def test_a_real_run_counts_its_transfers_and_its_time(two_processes):
    (folder, _), (summary, _) = two_processes
    assert summary["trials"] == 1
    assert 1 <= summary["attempted"] <= 2
    assert 0 <= summary["succeeded"] <= summary["attempted"]
    assert sum(summary["parts_s"].values()) == pytest.approx(summary["mean_time_s"])
    assert set(summary["compute_ms"]) >= {"perception", "planning"}
    assert summary["realtime_factor"] > 0.5
    assert (folder / "storyboard.png").stat().st_size > 10_000
