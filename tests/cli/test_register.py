import json

import numpy as np
import pytest
from typer.testing import CliRunner

from trocar.cli import app
from trocar.errors import TrocarError


def run(*args):
    return CliRunner().invoke(app, ["register", "points", *map(str, args)])


def save(folder, name, array):
    np.save(folder / name, array)
    return folder / name


@pytest.fixture
def pair(tmp_path):
    robot = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
    return save(tmp_path, "robot.npy", robot), save(tmp_path, "camera.npy", robot + np.array([0.1, 0.2, 0.3]))


@pytest.mark.parametrize("name", ["set_1", "set_2", "script"])
def test_the_stored_transforms_come_back(recordings, tmp_path, name):
    with np.load(recordings / "dvrk" / "registration" / f"{name}.npz") as data:
        robot = save(tmp_path, "robot.npy", data["p_robot"])
        camera = save(tmp_path, "camera.npy", data["p_camera"])
        stored, count = data["T_robot_camera"], len(data["p_robot"])
    result = run(robot, camera, "--json")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    np.testing.assert_allclose(found["T_robot_camera"], stored, rtol=0, atol=1e-9)
    assert found["inliers"] == count
    assert 0.0003 < found["rms_m"] < 0.0007


def test_without_json_the_pose_is_printed(pair):
    result = run(*pair)
    assert result.exit_code == 0
    assert "20 of 20 points" in result.stdout
    assert "-0.10000000" in result.stdout


def test_the_robust_option_leaves_a_wrong_pair_out(pair):
    robot = np.load(pair[0])
    robot[3] += 0.05
    np.save(pair[0], robot)
    found = json.loads(run(*pair, "--inlier-mm", "1", "--json").stdout)
    assert found["inliers"] == 19
    assert found["rms_m"] < 1e-12


@pytest.mark.parametrize(
    ("robot", "says"),
    [
        (np.zeros((20, 2)), "shape"),
        (np.zeros((19, 3)), "robot.npy has shape (19, 3)"),
        (np.full((20, 3), np.nan), "robot.npy' holds NaN"),
        (np.linspace([0, 0, 0], [1, 1, 1], 20), "one line"),
        (np.array(["a"] * 20), "not a readable"),
    ],
)
def test_bad_points_are_one_sentence(pair, robot, says):
    np.save(pair[0], robot)
    error = run(*pair, "--json").exception
    assert isinstance(error, TrocarError)
    assert says in str(error)
    assert "\n" not in str(error)


def test_missing_and_truncated_files_are_one_sentence(pair, tmp_path):
    assert isinstance(run(pair[0], tmp_path / "none.npy").exception, TrocarError)
    for content in (b"", pair[1].read_bytes()[:200]):
        pair[1].write_bytes(content)
        assert isinstance(run(*pair).exception, TrocarError)
