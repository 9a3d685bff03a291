"""``trocar station``: listing, showing and checking laboratories."""

import json

import numpy as np
import pytest

from trocar.lab import built_in_stations, load_station, station_text

PEGS = station_text("peg-transfer")


@pytest.fixture
def mine(tmp_path):
    """Write a station file of one's own: the peg transfer's with something replaced."""

    def write(*changes):
        text = PEGS
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        (tmp_path / "mine.toml").write_text(text)
        return tmp_path / "mine.toml"

    return write


def test_all_that_are_built_in_are_listed(trocar):
    code, out, _ = trocar("station", "list")
    assert code == 0
    assert [line.split(":")[0] for line in out.splitlines()] == list(built_in_stations())
    code, out, _ = trocar("station", "list", "--json")
    assert code == 0
    assert json.loads(out) == {name: load_station(name).about for name in built_in_stations()}


@pytest.mark.parametrize("name", built_in_stations())
def test_a_station_is_shown(trocar, name):
    station = load_station(name)
    code, out, _ = trocar("station", "show", name, "--json")
    assert code == 0 and out.count("\n") == 1
    shown = json.loads(out)
    assert shown["name"] == name
    assert list(shown["arms"]) == list(station.arms) and list(shown["cameras"]) == list(station.cameras)
    for arm, values in shown["arms"].items():
        assert values["model"] == station.arms[arm].model.name
        assert np.allclose(values["T_world_base"], station.arms[arm].T_world_base.matrix)
    code, out, _ = trocar("station", "show", name)
    assert code == 0
    for word in (*station.arms, *(f"camera {camera}" for camera in station.cameras)):
        assert word in out


def test_the_file_of_a_station_is_the_start_of_ones_own(trocar, tmp_path):
    code, out, _ = trocar("station", "show", "raven-pair", "--toml")
    assert code == 0
    (tmp_path / "mine.toml").write_text(out)
    assert out == station_text("raven-pair")
    code, shown, _ = trocar("station", "show", tmp_path / "mine.toml", "--json")
    assert code == 0 and json.loads(shown) == json.loads(trocar("station", "show", "raven-pair", "--json")[1])


@pytest.mark.parametrize("name", built_in_stations())
def test_what_is_built_in_is_well(trocar, name):
    assert trocar("station", "check", name)[:2] == (0, f"{name}: all is well\n")
    code, out, _ = trocar("station", "check", name, "--json")
    assert code == 0 and json.loads(out) == {"station": name, "ok": True, "findings": []}


def test_findings_are_sentences_and_code_1(trocar, mine):
    path = mine(("xyz_mm = [133.2, 0.0, 166.0]", "xyz_mm = [1133.2, 0.0, 166.0]"), ('"peg-transfer"', '"mine"'))
    code, out, err = trocar("station", "check", path)
    assert (code, err) == (1, "")
    *findings, last = out.splitlines()
    assert findings and last == f"mine: {len(findings)} findings"
    assert any("psm1" in finding for finding in findings)
    code, out, _ = trocar("station", "check", path, "--json")
    assert code == 1
    assert json.loads(out) == {"station": "mine", "ok": False, "findings": findings}


def test_a_transmission_of_ones_own_comes_with_a_plugin(trocar, mine, tmp_path):
    path = mine(('transmission = "psm1_grey"', 'transmission = "ropes-of-mine"'))
    plugin = tmp_path / "ropes.py"
    plugin.write_text(
        "from trocar.lab import TRANSMISSIONS\nTRANSMISSIONS.register('ropes-of-mine', TRANSMISSIONS['psm1_grey'])\n"
    )
    code, _, err = trocar("station", "check", path)
    assert code == 2 and "transmission 'ropes-of-mine' is unknown" in err
    assert trocar("station", "check", path, "--plugin", plugin)[0] == 0
    code, out, _ = trocar("station", "show", path, "--plugin", plugin, "--json")
    assert code == 0 and json.loads(out)["arms"]["psm1"]["transmission"] == "ropes-of-mine"


def test_a_station_is_exported_for_mujoco_and_its_arms_as_urdf(trocar, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    mjcf, urdf = tmp_path / "pair.xml", tmp_path / "urdf"
    words = ("station", "export", "raven-pair", "--mjcf", mjcf, "--urdf", urdf, "--json")
    assert trocar(*words)[0] == 0
    code, out, err = trocar(*words)  # its own files are written again
    assert code == 0, err
    assert json.loads(out)["files"] == [str(mjcf), str(urdf / "raven2-left.urdf"), str(urdf / "raven2-right.urdf")]
    assert mujoco.MjModel.from_xml_path(str(mjcf)).nu == 14
    assert mujoco.MjModel.from_xml_path(str(urdf / "raven2-left.urdf")).njnt == 9
    code, out, _ = trocar("station", "export", "peg-transfer", "--mjcf", tmp_path / "p.xml", "--task", "peg-transfer")
    assert code == 0 and f"python -m mujoco.viewer --mjcf={tmp_path / 'p.xml'}" in out
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "p.xml")).body("block5").id > 0


def test_work_out_of_an_arms_reach_is_told_before_anything_is_run(trocar, mine, tmp_path):
    far = mine(
        ("park = { tip_mm = [85.0, 45.0, 80.0], jaw_deg = 5.73 }\n", ""), ("[133.2, 0.0, 166.0]", "[133.2, 300, 166.0]")
    )
    code, out, _ = trocar("station", "check", far)
    said = (
        "arm 'psm1' reaches 0 % of the box in which its base is registered, from -60, -40, 0 to 60, 40, 50 mm; move its"
    )
    assert code == 1 and said in out
    for line in ("run peg-transfer --station", "calibrate collect"):
        code, out, err = trocar(*line.split(), far, "--out", tmp_path / "no")
        assert (code, out) == (2, "") and said in err and "trocar station check" in err
    assert not (tmp_path / "no").exists()
