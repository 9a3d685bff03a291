"""A collection over the network: the arm that wears the spheres in one process, who calibrates it in another."""

import json
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from crtk_partners import patient, trocar
from trocar.calibration.recording import load_recording
from trocar.collect.collection import Collection
from trocar.lab import load_station, station_text
from trocar.lab.session import draw_session

pytestmark = pytest.mark.realtime
SEED, ROWS, STOPPED_AT = 2, 30, 12


@pytest.fixture
def station(tmp_path):
    """The client's station, once a cell whose psm1 wears the spheres is served; it is ended whatever happens."""
    coarse, mine = tmp_path / "coarse.toml", tmp_path / "mine.toml"
    coarse.write_text(station_text("peg-transfer").replace("binning = 2 ", "binning = 4 "), encoding="utf-8")
    process = trocar("crtk", "serve", coarse, "--spheres", "psm1", "--seed", SEED, "--client-station", mine)
    for line in process.stdout:
        if "a client's station" in line:
            break
    patient(mine)
    yield mine
    process.kill()
    process.wait()


def test_a_collection_over_the_network_is_stopped_goes_on_and_finds_the_true_joints(station, tmp_path):
    """The joints are those of the embedded collection of this session, but for how far cables wander meanwhile."""
    words = ("calibrate", "collect", "--robot", f"crtk:{station}", "--arm", "psm1", "--rows", ROWS, "--wide")
    words = (*words, "--seed", SEED, "--no-fit", "--out", tmp_path / "cal", "--enable-motion", "--yes", "--json")
    spheres = tmp_path / "cal" / "spheres_psm1.npz"
    first = trocar(*words, stderr=subprocess.PIPE)
    rows_seen(first, spheres)
    first.send_signal(signal.SIGINT)
    out, err = first.communicate(timeout=120)
    assert first.returncode == 130 and "run the same command to continue" in " ".join(err.split()), err
    before = centers(spheres)
    assert STOPPED_AT <= len(before) < ROWS + 2
    again = trocar(*words, stderr=subprocess.PIPE)
    out, err = again.communicate(timeout=300)
    assert again.returncode == 0, err
    np.testing.assert_array_equal(centers(spheres)[: len(before)], before)  # what was seen is not looked at again
    found, recording = json.loads(out)["arms"]["psm1"], load_recording(tmp_path / "cal" / "recording_psm1.npz")
    cell = load_station(tmp_path / "coarse.toml")
    session, box = draw_session(cell, np.random.default_rng([SEED, 0])), cell.calibration_box("psm1")
    embedded = Collection(session, "psm1", box, np.random.SeedSequence([SEED, 1, 0]), ROWS, wide=True)
    np.testing.assert_allclose(recording.q_cmd, embedded.q_cmd, atol=1e-9)
    assert found["rows"] == ROWS + 2 and found["good_rows"] > 0.8 * ROWS
    wrist = np.sqrt(np.mean((recording.q_phy - embedded.q_joint)[recording.valid, 3:] ** 2, axis=0))
    assert (wrist < 0.25 * np.array(found["commanded_rms"])[3:]).all(), "it is the cables that were measured"


def rows_seen(process, path: Path):
    """Return when a collection's file has rows enough to stop it."""
    while process.poll() is None:
        if path.is_file() and len(centers(path)) >= STOPPED_AT:
            return
        time.sleep(0.2)
    raise AssertionError(process.communicate()[1])


def centers(path):
    with np.load(path) as file:
        return file["p_camera_m"]
