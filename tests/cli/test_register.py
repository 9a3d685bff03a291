"""``trocar register points``, and ``trocar register cell``: lenses, camera and bases in one command."""

import io
import json
from contextlib import redirect_stdout

import numpy as np
import pytest

from synthetic import unmarked
from trocar.cli import main
from trocar.lab import load_station, station_text
from trocar.lab.laboratory import build_cell
from trocar.lab.session import draw_session


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


FILES = {"station.toml", "report.json", "corners.png"}


@pytest.fixture(scope="module")
def mine(tmp_path_factory):
    """A station file: the pair at half its resolution, few views."""
    path = tmp_path_factory.mktemp("cell") / "mine.toml"
    text = station_text("raven-pair").replace('kind = "stereo"', 'kind = "stereo"\nbinning = 2')
    path.write_text(text.replace("views = 20", "views = 8"))
    return path


@pytest.fixture(scope="module")
def done(mine):
    """The folder that the command wrote, and what it printed."""
    folder = mine.parent / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "sys.argv", ["trocar", "register", "cell", str(mine), "--seed", "1", "--out", str(folder), "--json"]
        )
        with redirect_stdout(io.StringIO()) as printed, pytest.raises(SystemExit) as stop:
            main()
    assert not stop.value.code
    return folder, json.loads(printed.getvalue())


@pytest.mark.slow
def test_one_command_registers_a_cell_and_says_how_far_it_is_off(done):
    folder, report = done
    assert {path.name for path in folder.iterdir()} == FILES
    assert report == unmarked(folder / "report.json")
    assert report["views_shown"] == 8 and report["views_used"] >= 6
    assert report["lenses_rms_px"] < 0.5 and max(report["boards_rms_px"].values()) < 0.5
    assert report["off"]["base_to_base"]["right"]["mm"] < 2.5
    assert report["minutes_of_a_person"] > 1
    assert (folder / "corners.png").stat().st_size > 50_000


@pytest.mark.slow
def test_agents_get_the_registered_lenses_camera_and_bases_and_images_the_true_ones(done, mine):
    folder, report = done
    station = load_station(folder / "station.toml")
    lab = build_cell(station, seed=2)
    cell, camera = lab.cell, station.cameras["stereo"]
    np.testing.assert_allclose(
        cell.T_world_camera_registered["stereo"].matrix, report["T_world_camera"], rtol=0, atol=1e-9
    )
    for arm, found in report["T_world_base"].items():
        np.testing.assert_allclose(cell.T_world_base_registered[arm].matrix, found, rtol=0, atol=1e-9)
    assert cell.cameras["stereo"].model is camera.rig_registered and camera.rig_registered is not camera.model
    true = draw_session(load_station(mine), np.random.default_rng(0)).T_world_camera["stereo"]
    assert np.array_equal(lab.session.T_world_camera["stereo"].matrix, true.matrix)
