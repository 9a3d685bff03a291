import json

import numpy as np
import pytest


@pytest.fixture
def register(trocar):
    """Register points and return what was printed."""

    def run(*words):
        code, out, err = trocar("register", "points", *words)
        assert code == 0, err
        return out

    return run


def save(folder, name, array):
    np.save(folder / name, array)
    return folder / name


@pytest.fixture
def pair(tmp_path):
    robot = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
    return save(tmp_path, "robot.npy", robot), save(tmp_path, "camera.npy", robot + np.array([0.1, 0.2, 0.3]))


@pytest.mark.parametrize("name", ["set_1", "set_2", "script"])
def test_the_stored_transforms_come_back(register, recordings, tmp_path, name):
    with np.load(recordings / "dvrk" / "registration" / f"{name}.npz") as data:
        robot = save(tmp_path, "robot.npy", data["p_robot"])
        camera = save(tmp_path, "camera.npy", data["p_camera"])
        stored, count = data["T_robot_camera"], len(data["p_robot"])
    found = json.loads(register(robot, camera, "--json"))
    np.testing.assert_allclose(found["T_robot_camera"], stored, rtol=0, atol=1e-9)
    assert found["inliers"] == count
    assert 0.0003 < found["rms_m"] < 0.0007


def test_without_json_the_pose_is_printed(register, pair):
    out = register(*pair)
    assert "20 of 20 points" in out and "-0.10000000" in out


def test_the_robust_option_leaves_a_wrong_(register, pair):
    robot = np.load(pair[0])
    robot[3] += 0.05
    np.save(pair[0], robot)
    found = json.loads(register(*pair, "--inlier-mm", "1", "--json"))
    assert found["inliers"] == 19
    assert found["rms_m"] < 1e-12
