"""Registered poses in a station's file: written, read back, used by sessions."""

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.station import read_station, station_text
from trocar.station.registered import with_registered
from trocar.station.session import draw_session

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


def test_an_arm_without_a_table_of_its_own_is_refused():
    text = 'name = "bench"\nabout = "one"\n[arms]\npsm = { model = "psm-classic", transmission = "stiff" }\n'
    with pytest.raises(TrocarError, match=r"no table \[arms.psm\]"):
        with_registered(text, {"psm": FOUND["psm1"]})
    with pytest.raises(TrocarError, match=r"no table \[arms.psm9\]"):
        with_registered(station_text("peg-transfer"), {"psm9": FOUND["psm1"]})
