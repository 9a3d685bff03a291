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


@pytest.mark.parametrize("command", ["show", "check"])
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "peg-transfer"', "name = ", "mine.toml"),
        ('name = "peg-transfer"', 'nome = "peg-transfer"', "unknown key 'nome'; did you mean 'name'"),
        (
            'model = "psm-classic"',
            'model = "psm-future"',
            "arms.psm1.model: arm 'psm-future' is unknown; choose",
        ),
        ("xyz_mm = [133.2, 0.0, 166.0]", "xyz_mm = [nan, 0.0, 166.0]", "is nan"),
        ("xyz_mm = [133.2, 0.0, 166.0]", "xyz_inch = [5, 0, 7]", "unknown key 'xyz_inch'"),
    ],
)
def test_a_bad_file_is_one_sentence(trocar, mine, command, old, new, words):
    path = mine((old, new))
    for flags in ((), ("--json",)):
        code, out, err = trocar("station", command, path, *flags)
        assert (code, out) == (2, "")
        assert err.startswith("trocar: ") and err.count("\n") == 1
        assert words in err and str(path) in err


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("kitchen", "station 'kitchen' is unknown; choose one of peg-transfer"),
        ("kitchen.toml", "station file 'kitchen.toml' does not exist"),
        (".", "is unknown; choose one of"),
    ],
)
def test_a_station_that_is_not_there_is_one_sentence(trocar, tmp_path, monkeypatch, name, words):
    monkeypatch.chdir(tmp_path)
    for command in ("show", "check"):
        code, out, err = trocar("station", command, name)
        assert (code, out) == (2, "") and err.count("\n") == 1 and words in err


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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["peg-transfer"], "nothing to write; give --mjcf FILE.xml, --urdf FOLDER, or both"),
        (["peg-transfer", "--mjcf", "a.txt"], "'a.txt' must end in .xml"),
        (["peg-transfer", "--mjcf", "nowhere/a.xml"], "lie in a folder that exists"),
        (["kitchen", "--urdf", "urdf"], "station 'kitchen' is unknown"),
        (["peg-transfer", "--urdf", "urdf", "--task", "peg-transfer"], "--task is for the whole station"),
        (["peg-transfer", "--mjcf", "a.xml", "--task", "cooking"], "'cooking' is unknown; choose one of"),
        (["suture", "--mjcf", "a.xml", "--task", "peg-transfer"], "no fixture 'board'"),
        (["peg-transfer", "--mjcf", "a.xml", "--seed", "-1"], "--seed is '-1'"),
        (["peg-transfer", "--mjcf", "theirs.xml"], "theirs.xml' already exists"),
        (["peg-transfer", "--urdf", "theirs.xml"], "is a file where a folder is to be"),
    ],
)
def test_what_cannot_be_exported_is_one_sentence_and_writes_nothing(trocar, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "theirs.xml").write_text("<mine/>")
    code, out, err = trocar("station", "export", *words)
    assert (code, out) == (2, "") and said in err and err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["theirs.xml"]
    assert (tmp_path / "theirs.xml").read_text() == "<mine/>"


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
