"""Stations from TOML: valid content is read, everything else is refused."""

import re

import numpy as np
import pytest

from trocar.arms import ARMS, MOTION_LIMITS
from trocar.errors import TrocarError
from trocar.lab import (
    CheckerboardRegistration,
    built_in_stations,
    check_station,
    load_station,
    read_station,
    station_text,
)
from trocar.motion import rest_to_rest
from trocar.perception.image import Intrinsics, StereoRig

PEGS = station_text("peg-transfer")
RAVENS = station_text("raven-pair")


def changed(old, new, text=PEGS):
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize("name", built_in_stations())
def test_every_built_in_station_makes_sense(name):
    station = load_station(name)
    assert station.name == name and station.about
    assert check_station(station) == []


def test_the_three_that_tasks_need_are_there():
    assert {"peg-transfer", "suture", "raven-pair"} <= set(built_in_stations())


def test_what_the_peg_station_says():
    station = load_station("peg-transfer")
    assert list(station.arms) == ["psm1", "psm2"]
    arm = station.arms["psm1"]
    assert arm.model is ARMS["psm-classic"] and arm.limits is MOTION_LIMITS["paper"]
    assert np.allclose(arm.T_world_base.matrix, [[-1, 0, 0, 0.1332], [0, -1, 0, 0], [0, 0, 1, 0.166], [0, 0, 0, 1]])
    camera = station.cameras["overhead"]
    assert isinstance(camera.model, Intrinsics) and (camera.model.width, camera.model.height) == (960, 600)
    axis = camera.T_world_camera.matrix[:3, 2]
    assert np.degrees(np.arccos(-axis[2])) == pytest.approx(33.0)
    onto_table = camera.T_world_camera.translation_m - axis * camera.T_world_camera.translation_m[2] / axis[2]
    assert np.abs(onto_table).max() < 1e-6, "it looks at the middle of the board"


def test_an_arm_that_is_slowed_takes_the_same_path_later():
    arms = read_station(changed('limits = "paper"', 'limits = "paper"\nspeed = 0.2')).arms
    slow, usual = arms["psm1"].limits, MOTION_LIMITS["paper"]
    assert arms["psm2"].limits is usual
    way = np.array([0.3, -0.1, 0.02, 1.0, 0.5, -0.5])
    slowly, fast = rest_to_rest(np.zeros(6), way, slow), rest_to_rest(np.zeros(6), way, usual)
    assert slowly.duration_s == pytest.approx(5 * fast.duration_s)
    times_s = np.linspace(0, fast.duration_s, 50)
    assert np.allclose(slowly(5 * times_s), fast(times_s), atol=1e-9)


def test_what_the_raven_station_says():
    station = load_station("raven-pair")
    assert [arm.model.name for arm in station.arms.values()] == ["raven2-left", "raven2-right"]
    between = station.arms["right"].T_world_base.translation_m - station.arms["left"].T_world_base.translation_m
    assert np.allclose(between, [-0.149, 0.005, -0.006])
    rig = station.cameras["stereo"].model
    assert isinstance(rig, StereoRig)
    assert rig.T_left_right.translation_m == pytest.approx([0.0468, 0, 0])
    for arm in station.arms.values():
        R = arm.T_world_base.matrix[:3, :3]
        assert np.abs(R @ R.T - np.eye(3)).max() < 1e-12


def test_a_registration_by_a_checkerboard_is_read_and_checked():
    text = RAVENS
    how = read_station(text).registration
    assert isinstance(how, CheckerboardRegistration)
    assert (how.board.columns, how.board.rows, how.board.square_m) == (10, 7, pytest.approx(0.008))
    assert "checkerboard" in how.about and how.views >= 6
    for old, new, says in (
        ("columns = 10", "columns = 9", "looks the same after half a turn"),
        ("views = 20", "views = 3", "registration.views is 3; it should be greater than or equal to 6"),
        ('kind = "checkerboard"', 'kind = "tape"', "'tape' is unknown; choose one of points, checkerboard"),
        ('kind = "checkerboard"', 'kind = "points"', "registration has an unknown key"),
    ):
        with pytest.raises(TrocarError, match=re.escape(says)):
            read_station(changed(old, new, text))


def test_a_camera_may_be_registered_in_its_pose_alone():
    text = changed('kind = "stereo"', 'kind = "stereo"\nregistered = { pose = { xyz_mm = [1, 2, 3] } }', RAVENS)
    camera = read_station(text).cameras["stereo"]
    assert camera.T_world_camera_registered is not None
    assert camera.T_world_camera_registered.translation_m == pytest.approx([0.001, 0.002, 0.003])
    assert camera.model_registered is camera.model
    with pytest.raises(TrocarError, match=r"stereo\.registered has an unknown key 'lens'"):
        read_station(changed("pose = { xyz_mm = [1, 2, 3] }", "lens = 3", text))


def test_a_file_of_ones_own_is_read(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(changed('name = "peg-transfer"', 'name = "mine"'))
    assert load_station(path).name == "mine"
    assert load_station(str(path)).name == "mine"


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('name = "peg-transfer"', 'nome = "peg-transfer"', "unknown key 'nome'; did you mean 'name'"),
        ('name = "peg-transfer"', 'name = "x"\ncolour = "red"', "unknown key 'colour'; known are name"),
        ('model = "psm-classic"', 'model = "psm-future"', r"arms\.psm1\.model: arm 'psm-future' is unknown; choose"),
        ('transmission = "psm1_grey"', 'transmission = "ropes"', "'ropes' is unknown; choose one of psm1_grey"),
        ('limits = "paper"', 'limits = "paper"\nspeed = 2', "speed is 2; it should be less than or equal to 1"),
        ('limits = "paper"', 'limits = "none"', "choose one of model, paper, dvrk"),
        ("xyz_mm = [133.2, 0.0, 166.0]", "xyz_mm = [133.2, 0.0]", r"is \[133.2, 0.0\]; .* at least 3 items"),
        ("xyz_mm = [133.2, 0.0, 166.0]", "xyz_mm = [1e9, 0.0, 1.0]", "it should be less than or equal to 5000"),
        ("xyz_mm = [133.2, 0.0, 166.0]", "xyz_mm = [nan, 0.0, 1.0]", "is nan; it should be a finite number"),
        ("xyz_mm = [133.2, 0.0, 166.0]", "xyz_m = [0.1, 0.0, 1.0]", "unknown key 'xyz_m'; did you mean 'xyz_mm'"),
        ("rpy_deg = [0, 0, 180]", "rotation = [[1,0,0],[0,1,0],[0,0,2]]", "is not a rotation"),
        ("binning = 2", "binning = 0", "binning is 0; it should be greater than or equal to 1"),
        ("exposure_ms = 143", 'exposure_ms = "long"', "it should be a valid number"),
        (
            "workspace_mm = [[-150, -120, -15], [150, 120, 160]]",
            "workspace_mm = [[9, 9, 9], [1, 1, 1]]",
            "is not a box",
        ),
        ("tip_mm = [85.0, 45.0, 80.0]", "tip_mm = [85, 45, 80], q = [0,0,0,0,0,0]", "both 'tip_mm' and 'q'"),
        ("points = 270", "points = 3", "points is 3; it should be greater than or equal to 4"),
        ("points = 270", "points = true", "it should be a valid integer"),
        ('kind = "rgbd"', 'kind = "x-ray"', "it should be 'rgbd' or 'stereo'"),
        ('kind = "rgbd"', 'kind = "stereo"', "has no key 'baseline_mm'"),
        ("[arms.psm1]", "[arms", "is not TOML"),
        ("exposure_ms = 143", "flaws = 3\nexposure_ms = 143", "flaws is 3; give a table"),
        ("exposure_ms = 143", "flaws = { missing = true }\nexposure_ms = 143", r"flaws\.missing is True"),
        ('calibration = "psm1"', 'calibration = "psm3"', "it should be 'task', 'psm1' or 'psm2'"),
        ("rpy_deg = [0, 0, 180]", "rpy_deg = [0, 0, 0], rotation = [[1,0,0],[0,1,0],[0,0,1]]", "has both 'rpy_deg'"),
    ],
)
def test_what_a_station_cannot_say_is_one_sentence(old, new, match):
    with pytest.raises(TrocarError, match=match):
        read_station(changed(old, new), "mine.toml")


def test_a_station_without_arms_is_none():
    with pytest.raises(TrocarError, match=r"has no arm; give one or more under \[arms\.NAME\]"):
        read_station('name = "x"\nabout = "nothing"')


@pytest.mark.parametrize("where", ["nowhere.toml", "peg-tranfer", "folder.toml"])
def test_a_station_that_is_not_there_is_a_sentence_with_the_choices(tmp_path, where):
    (tmp_path / "folder.toml").mkdir()
    name = where if where == "peg-tranfer" else tmp_path / where
    with pytest.raises(TrocarError, match=r"peg-transfer, raven-pair, suture|give a TOML file"):
        load_station(name)


@pytest.mark.parametrize(
    ("old", "new", "finding"),
    [
        ("tip_mm = [85.0, 45.0, 80.0]", "tip_mm = [85.0, 45.0, 800.0]", "'psm1' cannot rest where 'park' says"),
        (
            "tip_mm = [85.0, 45.0, 80.0]",
            "tip_mm = [-80.0, 45.0, 80.0]",
            r"of 'psm1' and .* of 'psm2' rest -?\d+\.\d mm",
        ),
        ("tip_mm = [85.0, 45.0, 80.0]", "tip_mm = [85.0, 45.0, 20.0]", None),
        (
            "park = { tip_mm = [85.0, 45.0, 80.0], jaw_deg = 5.73 }",
            "park = { tip_mm = [85.0, 45.0, 80.0], jaw_deg = 170.0 }",
            r"'psm1' rests with its jaws open 170 deg, outside \[-40 deg, 80 deg\]",
        ),
        ("workspace_mm = [[-150, -120, -15]", "workspace_mm = [[-150, 50, -15]", "tip at 85, 45, 80 mm, outside"),
        (
            "rpy_deg = [-147, 0, 0]",
            "rpy_deg = [33, 0, 0]",
            "camera 'overhead' sees the middle of none of: fixture 'board'",
        ),
    ],
)
def test_a_station_is_checked_for_what_no_key_shows(old, new, finding):
    found = check_station(read_station(changed(old, new)))
    if finding is None:
        assert found == []
    else:
        assert len(found) == 1 and re.search(finding, found[0]), found
