"""``trocar calibrate apply``: commands for a user's own controller."""

import csv
import json

import numpy as np
import pytest

from trocar.arms import PSM_CLASSIC
from trocar.calibration.excitation import random_smooth_path
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import JOINT_NAMES, Recording


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A model file and a path as a CSV file, and the path."""
    folder = tmp_path_factory.mktemp("apply")
    q_cmd = random_smooth_path(PSM_CLASSIC, np.random.default_rng(0), 400)
    recording = Recording(q_cmd, PSM1_GREY.run(q_cmd), np.ones(400, dtype=bool), np.arange(400.0))
    wanted = random_smooth_path(PSM_CLASSIC, np.random.default_rng(1), 60)
    rows = np.column_stack([0.1 * np.arange(60), wanted])
    header = "t_s," + ",".join(JOINT_NAMES)
    np.savetxt(folder / "path.csv", rows, delimiter=",", header=header, comments="", fmt="%.9g")
    return recording.save(folder / "recording.npz"), folder / "path.csv", wanted


def model_of(trocar, files, folder, kind):
    path = folder / f"{kind}.npz"
    assert trocar("calibrate", "fit", files[0], "--model", kind, "--out", path)[0] == 0
    return path


def table_of(path):
    with path.open(newline="") as file:
        names, *rows = csv.reader(file)
    return names, np.array(rows, dtype=float)


def test_the_commands_bring_the_joints_nearer_to_the_path(trocar, files, tmp_path):
    model = model_of(trocar, files, tmp_path, "play")
    code, out, err = trocar("calibrate", "apply", model, files[1], "--out", tmp_path / "commands.csv", "--json")
    assert code == 0, err
    names, rows = table_of(tmp_path / "commands.csv")
    assert names == ["t_s", *JOINT_NAMES]
    np.testing.assert_allclose(rows[:, 0], 0.1 * np.arange(60), atol=1e-9)
    left, before = (PSM1_GREY.run(q)[20:, 3:] - files[2][20:, 3:] for q in (rows[:, 1:], files[2]))
    assert np.all(np.sqrt(np.mean(left**2, 0)) < 0.5 * np.sqrt(np.mean(before**2, 0)))
    said = json.loads(out)
    assert (said["rows"], said["model"]) == (60, "play")
    np.testing.assert_allclose(said["largest_correction"], np.abs(rows[:, 1:] - files[2]).max(axis=0), atol=1e-7)


def test_a_model_with_a_window_gets_rows_as_dense_as_it_was_fitted_on(trocar, files, tmp_path):
    model = model_of(trocar, files, tmp_path, "ridge")
    assert trocar("calibrate", "apply", model, files[1], "--out", tmp_path / "commands.csv")[0] == 0
    _, rows = table_of(tmp_path / "commands.csv")
    assert len(rows) > 60 and np.all(np.diff(rows[:, 0]) > 0) and rows[-1, 0] == pytest.approx(5.9)
