"""Registered poses in a station's file: written, read back, used by sessions."""

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.lab import read_station, station_text
from trocar.lab.session import draw_session
from trocar.lab.station_file import with_registered
from trocar.perception.image import Intrinsics, StereoRig

FOUND = {
    "psm1": SE3.from_parts(SO3.axis("z", 3.14) @ SO3.axis("x", 0.001), (0.1331, 0.0002, 0.1661)),
    "psm2": SE3.from_parts(SO3.axis("y", 0.002) @ SO3.axis("z", 3.1), (-0.1331, 0.0, 0.1659)),
}


def test_a_registered_pose_is_kept_exactly_and_nothing_else_changes():
    before = station_text("peg-transfer")
    after = with_registered(before, FOUND)
    station = read_station(after)
    for name, T in FOUND.items():
        found = station.arm(name).T_world_base_registered
        assert found is not None
        np.testing.assert_allclose(found.matrix, T.matrix, atol=1e-9)
        np.testing.assert_array_equal(
            station.arm(name).T_world_base.matrix, read_station(before).arm(name).T_world_base.matrix
        )
    assert [line for line in after.splitlines() if not line.startswith("registered")] == before.splitlines()


def test_registering_again_replaces_what_was_found_before():
    again = with_registered(with_registered(station_text("peg-transfer"), FOUND), {"psm1": FOUND["psm2"]})
    station = read_station(again)
    assert again.count("registered =") == 2
    found = station.arm("psm1").T_world_base_registered
    assert found is not None
    np.testing.assert_allclose(found.matrix, FOUND["psm2"].matrix, atol=1e-9)


def test_sessions_use_what_was_registered_and_say_so():
    station = read_station(with_registered(station_text("peg-transfer"), {"psm1": FOUND["psm1"]}))
    usual = read_station(station_text("peg-transfer"))
    day, other = (draw_session(which, np.random.default_rng(3)) for which in (station, usual))
    np.testing.assert_allclose(day.T_world_base_registered["psm1"].matrix, FOUND["psm1"].matrix, atol=1e-9)
    for name in ("T_world_base", "T_world_base_registered"):
        np.testing.assert_array_equal(getattr(day, name)["psm2"].matrix, getattr(other, name)["psm2"].matrix)
    assert station.flaws()["registration of psm1"] == "as the station file has it"
    assert "registration of psm1" not in usual.flaws()


RIG = StereoRig(
    Intrinsics(1280, 960, 1601.25, 1600.5, 638.7, 480.9, (-0.01, 0.002, 1e-4, -2e-4, 0.0)),
    Intrinsics(1280, 960, 1599.0, 1598.5, 641.0, 479.2, (0.01, -0.002, 0.0, 3e-4, 0.0)),
    SE3.from_parts(SO3.exp([1e-3, -2e-3, 5e-4]), (0.0469, 1e-5, -2e-5)),
)


def test_a_registered_camera_and_its_lenses_are_kept_and_sessions_use_them():
    T_camera = SE3.from_parts(SO3.axis("x", 2.47), (-0.0512, 0.1385, 0.0667))
    before = station_text("raven-pair")
    after = with_registered(before, {}, {"stereo": (T_camera, RIG)})
    assert [line for line in after.splitlines() if not line.startswith("registered")] == before.splitlines()
    station = read_station(after)
    camera = station.cameras["stereo"]
    for found, lens in ((camera.model_registered.left, RIG.left), (camera.model_registered.right, RIG.right)):
        assert found == lens
    T_left_right = camera.model_registered.T_left_right
    np.testing.assert_allclose(T_left_right.matrix, RIG.T_left_right.matrix, atol=1e-9)
    assert camera.model.left.fx == 1600
    day = draw_session(station, np.random.default_rng(0))
    usual = draw_session(read_station(before), np.random.default_rng(0))
    np.testing.assert_allclose(day.T_world_camera_registered["stereo"].matrix, T_camera.matrix, atol=1e-9)
    np.testing.assert_array_equal(day.T_world_camera["stereo"].matrix, usual.T_world_camera["stereo"].matrix)
    assert "registration of stereo" in station.flaws()
    assert with_registered(after, {}, {"stereo": (T_camera, RIG)}) == after
    with pytest.raises(TrocarError, match=r"no table \[cameras.mono\]; write 'mono' as one"):
        with_registered(before, {}, {"mono": (T_camera, RIG)})


def test_an_arm_without_a_table_of_its_own_is_refused():
    text = 'name = "bench"\nabout = "one"\n[arms]\npsm = { model = "psm-classic", transmission = "stiff" }\n'
    with pytest.raises(TrocarError, match=r"no table \[arms.psm\]"):
        with_registered(text, {"psm": FOUND["psm1"]})
    with pytest.raises(TrocarError, match=r"no table \[arms.psm9\]"):
        with_registered(station_text("peg-transfer"), {"psm9": FOUND["psm1"]})
