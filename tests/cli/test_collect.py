"""``trocar calibrate collect``: the whole chain in one command, resumed, refused."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from synthetic import unmarked
from trocar.calibration.recording import load_recording
from trocar.lab import load_station, station_text
from trocar.perception.fiducial_joints import GOOD, NOTHING

COMMAND = "from trocar.cli import main; main()"
FILES = ("calibration_psm1.png", "cables_psm1.npz", "loops_psm1.png", "recording_psm1.npz", "report.json")
ROWS = 100


@pytest.fixture(scope="module")
def station(tmp_path_factory):
    """The file of a station whose camera combines 4 x 4 pixels: its images are made in a third of the time."""
    path, text = tmp_path_factory.mktemp("station") / "coarse.toml", station_text("peg-transfer")
    assert text.count("binning = 2 ") == 1
    path.write_text(text.replace("binning = 2 ", "binning = 4 "))
    return path


def words_of(station, folder, *more):
    return ("calibrate", "collect", station, *("--arm", "psm1", "--rows", ROWS, "--seed", 2, "--out", folder), *more)


@pytest.fixture(scope="module")
def done(station, tmp_path_factory):
    """A folder with the whole chain of a hundred rows, and what was printed."""
    folder = tmp_path_factory.mktemp("chain") / "cal"
    words = [str(word) for word in words_of(station, folder, "--json")]
    result = subprocess.run([sys.executable, "-c", COMMAND, *words], capture_output=True, text=True, check=True)
    return folder, result.stdout


def test_one_command_collects_registers_fits_and_evaluates(done):
    folder, printed = done
    assert {path.name for path in folder.iterdir()} == {*FILES, "spheres_psm1.npz", "station.toml"}
    assert printed.count("\n") == 1
    report = json.loads(printed)
    assert report == unmarked(folder / "report.json")
    found = report["arms"]["psm1"]
    assert found["flags"][NOTHING] == 2 and found["flags"][GOOD] == found["good_rows"] > 0.85 * ROWS
    assert found["sphere_distance_rms_mm"] <= 0.35
    assert max(found["joint_rms"]) <= 0.01
    model = found["model"]
    assert model["fitted_rows"] + model["held_out_rows"] <= found["rows"] == ROWS + 2
    for joint in (3, 4, 5):
        assert model["rmse_after"][joint] < 0.5 * model["rmse_before"][joint]
    registered = load_station(folder / "station.toml").arm("psm1").T_world_base_registered
    assert registered is not None and found["registration"]["off_mm"] < 2.0
    for picture in ("calibration", "loops"):
        assert (folder / f"{picture}_psm1.png").stat().st_size > 10_000


def test_fit_and_evaluate_read_the_recording(done, trocar, tmp_path):
    recording = done[0] / "recording_psm1.npz"
    code, out, err = trocar(
        "calibrate", "fit", recording, "--fraction", 0.8, "--prior", "none", "--out", tmp_path / "m.npz", "--json"
    )
    assert code == 0, err
    code, out, err = trocar("calibrate", "evaluate", tmp_path / "m.npz", recording, "--from-row", 81, "--json")
    assert code == 0, err
    chain = json.loads((done[0] / "report.json").read_text())["arms"]["psm1"]["model"]
    assert json.loads(out)["rmse_after"] == pytest.approx(chain["rmse_after"])
    assert load_recording(recording).valid.sum() > 80


@pytest.mark.slow
def test_an_interrupted_collection_goes_on_to_the_same_files(done, station, trocar, tmp_path):
    folder = tmp_path / "cal"
    words = map(str, words_of(station, folder))
    started = subprocess.Popen(
        [sys.executable, "-c", COMMAND, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    until = time.monotonic() + 120
    while not (folder / "spheres_psm1.npz").is_file() and time.monotonic() < until:
        time.sleep(0.05)
    os.kill(started.pid, signal.SIGINT)
    _, err = started.communicate(timeout=120)
    assert started.returncode == 130 and "run the same command to continue" in " ".join(err.split())
    assert not (folder / "report.json").exists()
    code, out, _ = trocar(*words_of(station, folder))
    assert code == 0 and "sphere distances" in out
    for name in ("spheres_psm1.npz", *FILES[1:2], "recording_psm1.npz", "report.json", "station.toml"):
        assert (folder / name).read_bytes() == (done[0] / name).read_bytes(), name


def test_nothing_is_collected_if_a_file_that_is_read_would_be_replaced(station, trocar, tmp_path):
    mine = tmp_path / "station.toml"
    mine.write_text(station.read_text())
    code, _, err = trocar(*words_of(mine, tmp_path))
    assert code == 2 and "station.toml" in err and list(tmp_path.iterdir()) == [mine]


def test_a_folder_of_another_collection_is_refused(done, station, trocar):
    for other in (("--seed", 3), ("--difficulty", "harsh")):
        code, _, err = trocar(*words_of(station, done[0], "--no-fit", *other))
        assert code == 2 and "is of another collection; move it away" in err
