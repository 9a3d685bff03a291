"""``trocar run`` and ``trocar report``: what they print, save, resume and refuse."""

import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from processes import UNPICTURED, python
from synthetic import synthetic_trial, unmarked
from trocar.cli import app
from trocar.eval import jobs
from trocar.eval.config import RunConfig
from trocar.eval.folder import load_trials
from trocar.eval.trial import Trial, trial_file, trial_files
from trocar.report.stills import photographer_of
from trocar.report.summary import summarise
from trocar.sim.world import PhysicsError
from trocar.tasks.peg_transfer.report import PegReport

COMMAND = "from trocar.cli import main; main()"


def summary_of(folder: Path):
    """Return what a summary says besides who made it."""
    return unmarked(folder / "summary.json")


# What is printed and kept.


def test_json_is_one_object_equal_to_the_summary(trocar, played, tmp_path):
    code, out, _ = trocar("run", "peg-transfer", "--trials", 2, "--seed", 5, "--out", tmp_path / "run", "--json")
    assert code == 0
    assert out.count("\n") == 1
    trials, strange = load_trials(tmp_path / "run")
    assert json.loads(out) == summary_of(tmp_path / "run") == summarise(trials, PegReport())
    assert strange == []
    assert json.loads(out)["seed"] == 5
    assert played == [(0, 0), (0, 1)]


def test_the_table_names_task_figures_and_files(trocar, played, tmp_path):
    code, out, _ = trocar("run", "peg-transfer", "--out", tmp_path / "run")
    assert code == 0
    said = ("peg-transfer", "12 of 12", "5.0", "collisions per trial", "real time", "summary.json", "take longer")
    assert all(words in out for words in said)


def test_a_quiet_run_prints_the_end_of_its_result_alone(trocar, played, tmp_path):
    code, out, err = trocar("--quiet", "run", "peg-transfer", "--sessions", 2, "--out", tmp_path)
    assert (code, err) == (0, "") and len(out.splitlines()) == 3
    assert out.startswith("peg-transfer, calibrated (play): 24 of 24 transfers, 95 % interval")
    assert out.splitlines()[2].startswith("files: ")
    _, out, err = trocar("run", "peg-transfer", "--sessions", 2, "--out", tmp_path)
    assert len(out.splitlines()) > 20 and "nothing to run" in err, "the next line is not quiet"


def test_a_quiet_report_names_trials_that_it_leaves_aside(trocar, played, tmp_path):
    trocar("run", "peg-transfer", "--trials", 2, "--out", tmp_path)
    trial_file(tmp_path, 0, 0).write_bytes(b"")
    _, out, _ = trocar("report", tmp_path, "--quiet")
    assert "left aside" in " ".join(out.split()) and len(out.splitlines()) < 10


def test_sessions_times_trials_are_played_session_by_session(trocar, played, tmp_path):
    words = ("run", "peg-transfer", "--sessions", 2, "--trials", 3, "--out", tmp_path, "--json")
    code, out, _ = trocar(*words)
    assert code == 0
    assert played == [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)]
    summary = json.loads(out)
    assert (summary["sessions"], summary["trials"], summary["attempted"]) == (2, 6, 72)
    assert trial_files(tmp_path) == [trial_file(tmp_path, *place) for place in played]


def test_finished_trials_are_not_played_again(trocar, played, tmp_path):
    words = ("run", "peg-transfer", "--sessions", 2, "--trials", 2, "--out", tmp_path, "--json")
    first = trocar(*words)[1]
    trial_file(tmp_path, 1, 0).unlink()
    played.clear()
    code, out, _ = trocar(*words)
    assert (code, played) == (0, [(1, 0)])
    assert json.loads(out) == json.loads(first)
    played.clear()
    code, out, err = trocar(*words)
    assert (code, played) == (0, [])
    assert json.loads(out) == json.loads(first)
    assert "has the run's 4 trials" in " ".join(err.split()) and "nothing to run" in err


def test_another_run_in_the_same_folder_is_refused(trocar, played, tmp_path):
    trocar("run", "peg-transfer", "--out", tmp_path, "--json")
    played.clear()
    code, out, err = trocar("run", "peg-transfer", "--seed", 1, "--out", tmp_path, "--json")
    assert (code, out, played) == (2, "", [])
    assert err.count("\n") == 1 and "holds another run (seed 0)" in err
    assert summary_of(tmp_path)["seed"] == 0


def test_new_session_mounts_the_instruments_again_and_is_another_run(trocar, played, tmp_path):
    code, _, _ = trocar("run", "peg-transfer", "--new-session", "--refit-offsets", "--out", tmp_path, "--json")
    kept = json.loads((tmp_path / "run.json").read_text())
    assert (code, kept["new_session"], kept["refit_offsets"]) == (0, True, True)
    code, _, err = trocar("run", "peg-transfer", "--out", tmp_path)
    assert code == 2 and "new_session True" in err


def test_the_difficulty_and_the_sizes_of_all_flaws_are_told(trocar, played, tmp_path):
    more = ("--difficulty", "recorded", "--flaw", "registration=1mm", "--flaw", "residual=0", "--out", tmp_path)
    _, out, _ = trocar("run", "peg-transfer", *more)
    said = summary_of(tmp_path)["flaws"]
    assert said["difficulty"] == "recorded, registration=1mm, residual=0" and "registration=1mm" in out
    sizes = {name.partition(":")[0]: size for name, size in said.items()}
    assert (sizes["registration"], sizes["residual"], sizes["wear"]) == ("1 mm", "0 deg", "1 x")
    assert "kinematics" not in sizes, "no Raven is there"


def test_a_run_says_its_difficulty_and_only_what_differs_from_it(trocar, played, tmp_path):
    words = ("--flaw", "creep=0", "--flawless-camera", "--calibration", "joints")
    _, out, _ = trocar("run", "peg-transfer", "--out", tmp_path, *words)
    shown = " ".join(out.split())
    assert "laboratory: difficulty recorded except for creep=0; flaws of camera overhead switched off; cable" in shown
    assert "cable models are fitted on joints with drawn noise; summary.json has the size of every flaw" in shown
    assert "transmission of" not in shown and len(summary_of(tmp_path)["flaws"]) > 10


# Trials that are not counted.


@pytest.mark.parametrize("spoiled", [0, 1])
def test_a_broken_trial_is_named_by_report_and_the_rest_is_counted(trocar, played, tmp_path, spoiled):
    trocar("run", "peg-transfer", "--trials", 2, "--out", tmp_path)
    path = trial_file(tmp_path, 0, spoiled)
    path.write_bytes(path.read_bytes()[:500])
    code, out, _ = trocar("report", tmp_path)
    shown = "".join(out.split())
    assert code == 0
    assert "leftaside:" in shown and f"trial_00{spoiled}.npz" in shown
    assert f"trial_00{spoiled}.npz" in (tmp_path / "report.html").read_text()
    assert summary_of(tmp_path)["trials"] == 1
    trial_file(tmp_path, 0, 1 - spoiled).unlink()
    code, out, err = trocar("report", tmp_path, "--json")
    assert (code, out) == (2, "") and err.count("\n") == 1 and str(path) in err


# Ctrl-C.


def interrupt_at(monkeypatch, number):
    def run_trial(config, prepared, index, listener=None, *, raise_errors=False, attendant=None):
        if index == number:
            raise KeyboardInterrupt
        return synthetic_trial(config, index, session=prepared.number)

    monkeypatch.setattr(jobs, "run_trial", run_trial)


def test_ctrl_c_keeps_finished_trials_and_says_so(trocar, played, monkeypatch, tmp_path):
    interrupt_at(monkeypatch, 1)
    code, out, _ = trocar("run", "peg-transfer", "--trials", 3, "--out", tmp_path)
    assert code == 130
    assert "stopped; 1 finished trial kept; run the same command to continue" in " ".join(out.split())
    assert summary_of(tmp_path)["trials"] == 1
    assert not list(tmp_path.rglob(".*"))
    interrupt_at(monkeypatch, None)
    code, out, _ = trocar("run", "peg-transfer", "--trials", 3, "--out", tmp_path, "--json")
    assert code == 0
    assert json.loads(out)["trials"] == 3


def test_a_trial_whose_physics_broke_down_is_told_and_the_next_one_is_played(trocar, played, monkeypatch, tmp_path):
    def run_trial(config, prepared, index, listener=None, *, raise_errors=False, attendant=None):
        if index == 0:
            raise PhysicsError(0.2)
        return synthetic_trial(config, index, session=prepared.number)

    monkeypatch.setattr(jobs, "run_trial", run_trial)
    code, out, err = trocar("run", "peg-transfer", "--trials", 2, "--out", tmp_path)
    told = " ".join(err.split())
    assert code == 0 and "trial_000.npz is void: the physics became unstable at 0.200 s" in told
    assert summary_of(tmp_path)["trials"] == 1 and "1 of the run's 2 trials exist" in " ".join(out.split())


def test_ctrl_c_before_the_first_trial_leaves_no_summary(trocar, played, monkeypatch, tmp_path):
    interrupt_at(monkeypatch, 0)
    code, out, err = trocar("run", "peg-transfer", "--out", tmp_path, "--json")
    assert code == 130
    assert out == ""
    assert "stopped before the first trial was finished; the same command starts again" in " ".join(err.split())
    assert not (tmp_path / "summary.json").exists()


@pytest.mark.slow
def test_a_real_ctrl_c_in_a_running_trial_ends_it_without_a_traceback(tmp_path):
    quick = ("--transfers", "1", "--method", "uncalibrated", "--flawless-camera")
    options = (*quick, "--trials", "50", "--out", str(tmp_path), "--json")
    with subprocess.Popen(
        [sys.executable, "-c", UNPICTURED, "run", "peg-transfer", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        deadline = time.monotonic() + 600
        while not trial_file(tmp_path, 0, 0).is_file() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        try:
            out, err = process.communicate(timeout=600)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    assert process.returncode == 130, err
    assert "Traceback" not in err
    kept = len(trial_files(tmp_path))
    assert kept >= 1
    assert json.loads(out)["trials"] == summary_of(tmp_path)["trials"] == kept < 50
    assert not list(tmp_path.rglob(".*"))


# Reports.


def test_a_report_writes_the_same_summary_and_plays_nothing(trocar, played, tmp_path):
    trocar("run", "peg-transfer", "--trials", 2, "--out", tmp_path)
    before = (tmp_path / "summary.json").read_bytes()
    (tmp_path / "summary.json").unlink()
    played.clear()
    code, out, _ = trocar("report", tmp_path, "--json")
    assert (code, played) == (0, [])
    assert (tmp_path / "summary.json").read_bytes() == before
    assert json.loads(out) == summary_of(tmp_path)


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """A real run of one transfer in each of two sessions, in a process of its own; its folder and its summary."""
    folder = tmp_path_factory.mktemp("real")
    words = "run peg-transfer --transfers 1 --sessions 2 --trials 1 --new-session --refit-offsets --seed 21 "
    words += "--calibration joints --model offset --json --strict"
    result = python(["-c", COMMAND, *words.split(), "--out", folder], folder)
    summary = json.loads(result.stdout)
    assert result.returncode == (summary["succeeded"] < summary["attempted"]), result.stderr
    return folder, summary


def test_a_real_run_counts_its_transfers_and_its_time(real):
    folder, summary = real
    assert (summary["sessions"], summary["trials"], summary["attempted"]) == (2, 2, 2)
    assert 0 <= summary["succeeded"] <= 2
    assert sum(summary["parts_s"].values()) == pytest.approx(summary["mean_time_s"])
    assert set(summary["compute_ms"]) >= {"perception", "planning", "compensation"}
    assert summary["realtime_factor"] > 0
    assert {path.name for path in folder.iterdir()} - {"failed"} == {
        *("run.json", "summary.json", "report.html", "replay.html"),
        *("storyboard.png", "paths.png", "timechart.png", "session_00", "session_01"),
    }
    for name in ("storyboard.png", "paths.png", "timechart.png"):
        assert (folder / name).stat().st_size > 10_000
    assert 100_000 < (folder / "replay.html").stat().st_size < 3 << 20
    for session in (0, 1):
        assert {path.name for path in trial_file(folder, session, 0).parent.iterdir()} == {
            *("cables_psm1.npz", "trial_000.npz", "trial_000.timing.json")
        }


@pytest.fixture
def small_pictures(monkeypatch):
    """Draw the frames of videos .4 as wide: whole ones take a minute. Return the scales that were asked for."""
    asked = []

    def photographer(trial, report, scale):
        asked.append(scale)
        return photographer_of(trial, report, 0.4 * scale)

    monkeypatch.setattr("trocar.report.video.photographer_of", photographer)
    return asked


@pytest.mark.slow
def test_a_video_is_a_moving_picture_of_the_first_trial(trocar, real, small_pictures, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(real[0], folder)
    before = (folder / "summary.json").read_bytes()
    code, out, err = trocar("report", folder, "--video", "--json")
    assert code == 0, err
    assert out.count("\n") == 1 and json.loads(out) == real[1]
    assert "video.webp" in err and small_pictures == [0.75]
    assert (folder / "summary.json").read_bytes() == before
    with Image.open(folder / "video.webp") as film:
        assert film.format == "WEBP" and film.n_frames > 10
    assert not list(folder.rglob(".*"))


@pytest.mark.slow
def test_a_film_shows_the_whole_trial_at_its_own_speed(trocar, real, small_pictures, tmp_path):
    av = pytest.importorskip("av")
    folder = tmp_path / "copy"
    shutil.copytree(real[0], folder)
    for _ in range(2):  # it replaces its own file
        code, _, err = trocar("report", folder, "--mp4", "--json")
        assert code == 0 and "video.mp4" in err, err
    assert small_pictures == [1.0] * 2
    with av.open(str(folder / "video.mp4")) as file:
        stream = file.streams.video[0]
        lasts_s = float(stream.duration * stream.time_base)
        assert stream.codec_context.name == "h264" and stream.width % 2 == stream.height % 2 == 0
        first, *_, last = (frame.to_ndarray(format="rgb24").astype(int) for frame in file.decode(video=0))
    duration_s = Trial.load(trial_file(folder, 0, 0)).duration_s
    assert abs(lasts_s - duration_s) < 0.1
    assert first.std() > 20 and (np.abs(first - last).max(-1) > 30).mean() > 0.005, "the arm and its block have moved"


def test_an_option_of_one_task_is_none_of_anothers():
    shown = {}
    for task in ("peg-transfer", "suture"):
        result = CliRunner().invoke(app, ["run", task, "--help"], env={"COLUMNS": "200"})
        assert result.exit_code == 0
        shown[task] = result.output
    assert "--transfers" in shown["peg-transfer"] and "--transfers" not in shown["suture"]
    assert "bilateral" in shown["peg-transfer"] and "bilateral" not in shown["suture"], "variants are each task's own"
    for option in ("--count", "--preset", "--plan ", "--direction"):
        assert option in shown["suture"] and option not in shown["peg-transfer"]
    of_run = {field.name: field.metadata for field in fields(RunConfig) if field.metadata}
    assert len(of_run) == 19, "all but the task and the plugins"
    for name, about in of_run.items():
        for text in (" ".join(text.split()) for text in shown.values()):
            assert f"--{(about['flag'] or name).replace('_', '-')} " in text and about["help"] in text


# What is loaded to look at a trial.

HEAVY = ("mujoco", "trio", "cv2", "piqp", "trocar.sim", "trocar.eval.run", "trocar.tasks.peg_transfer.world")
HEAVY += ("trocar.tasks.suture.world", "trocar.tasks.peg_transfer.agents", "trocar.tasks.suture.agents")


def loaded_by(code):
    """Return the modules of a process that has run this code."""
    result = subprocess.run(
        [sys.executable, "-c", f"import sys; {code}; print(*sys.modules, file=sys.stderr)"],
        capture_output=True,
        text=True,
        check=True,
    )
    return set(result.stderr.split())


@pytest.mark.parametrize(
    "code",
    [
        "import trocar.report, trocar.report.files, trocar.report.summary, trocar.report.tables, trocar.report.page",
        "import trocar.eval; from trocar.eval.folder import load_trials; load_trials({folder!r})",
        "from trocar.cli.report import trial_in; from trocar.eval.trial import Trial; import pathlib;"
        "Trial.load(trial_in(pathlib.Path({folder!r}), 0, 0)).replay(); import trocar.view.trial_view",
        "from trocar.eval.folder import load_trials; from trocar.report.files import report_of;"
        "from trocar.report.summary import summarise; trials, _ = load_trials({folder!r});"
        "summarise(trials, report_of(trials[0]))",
    ],
    ids=["trocar.report", "trocar.eval", "trocar view", "summary"],
)
def test_looking_at_trials_loads_neither_the_simulator_nor_the_worlds_of_tasks(real, code):
    modules = loaded_by(code.format(folder=str(real[0])))
    assert "trocar.eval" in modules or "trocar.report" in modules
    assert not modules & set(HEAVY)


def test_to_view_a_trial_the_code_of_its_task_is_not_needed(real):
    code = f"from trocar.eval.trial import Trial; Trial.load({str(trial_file(real[0], 0, 0))!r}).replay()"
    assert not {name for name in loaded_by(code) if name.startswith(("trocar.tasks.peg_transfer", "trocar.tasks.sut"))}


@pytest.mark.slow
def test_trials_at_once_are_the_same_as_one_after_the_other(trocar, unpictured, tmp_path):
    quick = ("--method", "uncalibrated", "--transfers", "1", "--budget", "3", "--flawless-camera")
    words = ["run", "peg-transfer", *quick, "--trials", "2", "--seed", "4"]
    for count in ("1", "2"):
        trocar(*words, "--jobs", count, "--out", tmp_path / count)
    one, two = ([path.read_bytes() for path in trial_files(tmp_path / count)] for count in ("1", "2"))
    assert len(one) == 2
    assert one == two
