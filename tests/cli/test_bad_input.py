"""Every command with every kind of bad input: one sentence on stderr, exit code 2, nothing half-written."""

import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest

from trocar.calibration.models import MODELS, save_model
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import load_recording
from trocar.cli import main
from trocar.eval.trial import trial_file
from trocar.lab import station_text
from trocar.tasks.peg_transfer.shapes import Block

WAYPOINTS = [
    [0.2, -0.3, 0.15, 0.1, 0.3, 0.2],
    [0.2, -0.3, 0.11, 0.1, 0.3, 0.2],
    [-0.1, 0.1, 0.11, 0.2, -0.1, 0.1],
    [-0.1, 0.1, 0.14, 0.2, -0.1, 0.1],
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder of good and bad files; every command runs in it, and none may write there."""
    tmp_path = tmp_path_factory.mktemp("files")
    rng = np.random.default_rng(0)
    q = np.clip(np.cumsum(rng.normal(0, 0.05, (60, 6)), axis=0), -1, 1)
    q_phy = PSM1_GREY.measure(PSM1_GREY.run(q), rng)
    points = rng.uniform(-0.1, 0.1, (20, 3))
    face = Block().top_face_m() + [0, 0, 0.5]
    good = {
        "recording.npz": {"q_cmd": q, "q_phy": q_phy},
        "short.npz": {"q_cmd": q[:5], "q_phy": q_phy[:5]},
        "unequal.npz": {"q_cmd": q, "q_phy": q_phy[:-1]},
        "five.npz": {"q_cmd": q[:, :5], "q_phy": q_phy[:, :5]},
        "nan.npz": {"q_cmd": np.where(q == q[3, 3], np.nan, q), "q_phy": q_phy},
        "allbad.npz": {"q_cmd": q, "q_phy": q_phy, "valid": np.zeros(60, bool)},
        "capture.npz": {"points_m": face},
        "other.npz": {"something": face},
        "flat.npz": {"points_m": face[:, :2]},
        "nanpoints.npz": {"points_m": np.full((500, 3), np.nan)},
        "nopoints.npz": {"points_m": np.zeros((0, 3))},
        "words.npz": {"q_cmd": np.array(["a"]), "q_phy": np.array(["b"]), "points_m": np.array(["c"])},
    }
    for name, arrays in good.items():
        np.savez(tmp_path / name, **arrays)
    np.save(tmp_path / "points.npy", points)
    np.save(tmp_path / "fewer.npy", points[:-1])
    np.save(tmp_path / "nan.npy", np.where(points == points[2, 1], np.nan, points))
    np.save(tmp_path / "one.npy", points[:1])
    np.save(tmp_path / "words.npy", np.array(["a", "b"]))
    np.save(tmp_path / "waypoints.npy", np.array(WAYPOINTS))
    np.save(tmp_path / "far.npy", np.array(WAYPOINTS) + [0, 0, 1, 0, 0, 0])
    np.save(tmp_path / "empty_array.npy", np.zeros((0, 4, 6)))
    np.save(tmp_path / "objects.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    for suffix in ("npz", "npy"):
        (tmp_path / f"empty.{suffix}").write_bytes(b"")
        (tmp_path / f"text.{suffix}").write_text("no numbers here")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "recording.npz").read_bytes()[:700])
    (tmp_path / "cut.npy").write_bytes((tmp_path / "points.npy").read_bytes()[:200])
    arrays = {"q_cmd": q, "q_phy": q_phy, "points_m": face, "waypoints": q, "log": q}
    np.savez_compressed(tmp_path / "damaged.npz", **arrays)
    damaged = bytearray((tmp_path / "damaged.npz").read_bytes())
    damaged[100:800] = bytes(700)
    (tmp_path / "damaged.npz").write_bytes(damaged)
    (tmp_path / "folder").mkdir()
    (tmp_path / "halfdata").mkdir()
    np.save(tmp_path / "halfdata" / "q_cmd.npy", q)
    trials = {name: trial_file(tmp_path / name, 0, 0) for name in ("badtrial", "cuttrial", "damagedtrial", "otherrun")}
    for path in trials.values():
        path.parent.mkdir(parents=True)
    trials["badtrial"].write_bytes(b"")
    trials["cuttrial"].write_bytes((tmp_path / "recording.npz").read_bytes()[:500])
    trials["damagedtrial"].write_bytes(damaged)
    np.savez(trials["otherrun"], q=q)
    (tmp_path / "otherrun" / "run.json").write_text(json.dumps({"task": "peg-transfer", "seed": 99}))
    (tmp_path / "badrecord").mkdir()
    (tmp_path / "badrecord" / "run.json").write_text("{")
    (tmp_path / "broken.py").write_text("1 / 0\n")
    text = station_text("peg-transfer")
    (tmp_path / "nan.toml").write_text(text.replace("133.2", "nan", 1))
    (tmp_path / "key.toml").write_text("colour = 'red'\n" + text)
    (tmp_path / "cut.toml").write_text(text[:200])
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    rows = load_recording(tmp_path / "recording.npz")
    save_model(MODELS["offset"].fit(rows, np.random.default_rng(0)), tmp_path / "model.npz")
    (tmp_path / "cutmodel.npz").write_bytes((tmp_path / "model.npz").read_bytes()[:900])
    return tmp_path


@pytest.fixture(autouse=True)
def in_the_folder(folder, monkeypatch):
    monkeypatch.chdir(folder)


RUN, FIT = "run peg-transfer", "calibrate fit"
BAD_ARRAYS = ("missing", "empty", "text", "cut", "words")
BAD_STATIONS = ("missing", "nan", "key", "cut", "bytes")
BAD_PLUGINS = ("missing.py", "broken.py", "recording.npz", "folder")
PLUGGED = (
    "report badtrial",
    "station show suture",
    "plan transfer waypoints.npy",
    f"{FIT} recording.npz --out m.npz",
    "calibrate evaluate model.npz recording.npz",
)
BAD = [
    "run peg-transfers",
    "run debridement --arms 3",
    f"{RUN} --variant trilateral",
    f"{RUN} --method magic",
    f"{RUN} --model gru",
    f"{RUN} --trials 0",
    f"{RUN} --trials -3",
    f"{RUN} --seed -1",
    f"{RUN} --method uncalibrated --refit-offsets",
    f"{RUN} --out recording.npz",
    f"{RUN} --out recording.npz/inside",
    f"{RUN} --out otherrun",
    f"{RUN} --out badrecord",
    f"{RUN} --sessions 0",
    f"{RUN} --planner magic",
    f"{RUN} --perception magic",
    f"{RUN} --transfers 0",
    f"{RUN} --transfers 13",
    f"{RUN} --budget 0",
    f"{RUN} --budget nan",
    f"{RUN} --station kitchen",
    f"{RUN} --station suture",
    *(f"{RUN} --station {name}.toml" for name in BAD_STATIONS),
    *(f"{RUN} --plugin {name}" for name in BAD_PLUGINS),
    *(f"run --plugin {name} peg-transfer" for name in BAD_PLUGINS),
    "run suture --budget 0",
    "run suture --sutures 0",
    "run suture --sutures 1000",
    "run suture --plan missing.json",
    "run suture --plan text.npy",
    "run suture --station raven-pair",
    *(f"station {command} {name}.toml" for command in ("show", "check") for name in BAD_STATIONS),
    "station show kitchen",
    "station check folder",
    *(f"{line} --plugin {name}" for line in PLUGGED for name in BAD_PLUGINS),
    "view missing",
    "view folder",
    "view badtrial",
    "view badtrial --session 1",
    "report missing",
    "report folder",
    "report recording.npz",
    "report badtrial",
    "report cuttrial",
    "report damagedtrial",
    "report otherrun",
    *(f"{FIT} {name}.npz --out m.npz" for name in BAD_ARRAYS),
    *(f"{FIT} {name}.npz --out m.npz" for name in ("short", "unequal", "five", "nan", "allbad", "other", "damaged")),
    f"{FIT} folder --out m.npz",
    f"{FIT} halfdata --out m.npz",
    f"{FIT} recording.npz --out m.npz --model gru",
    f"{FIT} recording.npz --out m.npz --fraction 0",
    f"{FIT} recording.npz --out m.npz --fraction nan",
    f"{FIT} recording.npz --out m.npz --rows 0",
    f"{FIT} recording.npz --out m.npz --rows -1",
    f"{FIT} recording.npz --out m.npz --rows 61",
    f"{FIT} recording.npz --out m.npz --seed -1",
    f"{FIT} recording.npz --out nowhere/m.npz",
    f"{FIT} recording.npz --out m.txt",
    f"{FIT} recording.npz --out folder",
    *(f"calibrate evaluate {name}.npz recording.npz" for name in (*BAD_ARRAYS, "recording", "damaged", "cutmodel")),
    *(f"calibrate evaluate model.npz {name}.npz" for name in (*BAD_ARRAYS, "unequal", "five", "nan", "damaged")),
    "calibrate evaluate model.npz recording.npz --from-row -1",
    "calibrate evaluate model.npz recording.npz --from-row 60",
    "calibrate evaluate model.npz recording.npz --refit -1",
    "calibrate evaluate model.npz recording.npz --refit 1000",
    "calibrate evaluate model.npz recording.npz --plot nowhere/loops.png",
    "calibrate evaluate model.npz recording.npz --plot folder",
    "calibrate evaluate model.npz recording.npz --plot loops.xyz",
    "study calibration --data missing",
    *(f"export {name} --out tables" for name in ("missing", "folder", "badtrial", "recording.npz", "empty.npz")),
    "export recording.npz --out recording.npz",
    "study calibration --data folder",
    "study calibration --data recording.npz",
    *(f"register points {name}.npy points.npy" for name in (*BAD_ARRAYS, "fewer", "nan", "one", "objects")),
    *(f"register points points.npy {name}.npy" for name in (*BAD_ARRAYS, "fewer", "nan")),
    "register points one.npy one.npy",
    "register points folder points.npy",
    "register points recording.npz points.npy",
    "register points cut.npz points.npy",
    "register points points.npy points.npy --inlier-mm 0",
    "register points points.npy points.npy --inlier-mm nan",
    *(f"register block {name}.npz" for name in (*BAD_ARRAYS, "other", "flat", "nanpoints", "nopoints", "damaged")),
    *(f"register block {name}.npy --unit m" for name in (*BAD_ARRAYS, "objects")),
    "register block points.npy",
    "register block capture.npz --unit inch",
    "register block folder",
    *(f"plan transfer {name}.npy" for name in (*BAD_ARRAYS, "points", "nan", "empty_array", "objects", "far")),
    *(f"plan transfer {name}.npz" for name in (*BAD_ARRAYS, "other", "damaged")),
    "plan transfer folder",
    "plan transfer waypoints.npy --planner magic",
    "plan transfer waypoints.npy --arm psm-xi",
    "plan transfer waypoints.npy --limits none",
    "plan transfer waypoints.npy --up 0 0 0",
    "plan transfer waypoints.npy --up nan 0 1",
    "plan suture --preset magic",
    "plan suture --count 0",
    "plan suture --count 7",
    "plan suture --positions 2",
    "plan suture --count 6 --min-gap-deg 70",
    "plan suture --min-gap-deg nan",
    "plan suture --forbid-deg here",
    "plan suture --fix-deg 90.5",
    "plan suture --tension -1",
    "plan suture --margin best",
    "plan suture --joints all --margin paper",
    "plan suture --weight nan",
    "plan suture --arm psm-xi",
    "plan suture --circle-radius-mm 0",
    "plan suture --needle-radius-mm 20",
    "plan suture --needle-arc-deg nan",
    "plan suture --center-mm nan 0 0",
    "plan suture --normal 0 0 0",
    "plan suture --base-up-mm inf",
    "plan suture --pushes -1",
    "plan suture --theta-is end",
    "plan suture --out recording.npz",
    *(f"plan suture --demonstrations {name}" for name in ("missing", "folder", "recording.npz", "text.npy")),
    "plan setup --preset magic",
    "plan setup --free foo",
    "plan setup --bound circle_radius_mm",
    "plan setup --evaluations 1",
    "plan setup --count 0",
    "plan setup --out recording.npz",
    "study suture --preset magic",
    "study suture --positions 90",
    "study suture --out recording.npz",
]
USAGE = [
    "fly",
    "run",
    "run peg-transfer --speed 3",
    "run peg-transfer --trials many",
    "run peg-transfer --sutures 3",
    "run suture --transfers 3",
    "run suture --plugin",
    "station",
    "station fly",
    "view badtrial --port 99999",
    "report",
    "calibrate bend",
    "calibrate fit recording.npz",
    "calibrate evaluate model.npz",
    "plan transfer",
    "plan transfer waypoints.npy --up 1 2",
    "plan suture --count many",
    "plan suture --normal 1 2",
    "register points points.npy",
    "register block capture.npz --unit",
    "study magic",
    "export recording.npz",
]


def trocar(monkeypatch, capsys, line):
    monkeypatch.setattr("sys.argv", ["trocar", *line.split()])
    with pytest.raises(SystemExit) as end:
        main()
    output = capsys.readouterr()
    return end.value.code or 0, output.out, output.err


def contents(folder):
    return {path.relative_to(folder): path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("line", BAD)
def test_bad_input_is_one_sentence_and_code_2(folder, monkeypatch, capsys, line):
    before = contents(folder)
    flags = ["", *([" --json"] if not line.startswith("view") else [])]
    for flag in flags:
        code, out, err = trocar(monkeypatch, capsys, line + flag)
        assert code == 2, err
        assert out == ""
        assert re.fullmatch(r"trocar: [^\n]+\n", err), err
        assert contents(folder) == before, "something was written"


@pytest.mark.parametrize("line", USAGE)
def test_wrong_usage_is_code_2(folder, monkeypatch, capsys, line):
    before = contents(folder)
    code, out, err = trocar(monkeypatch, capsys, line)
    assert code == 2
    assert out == ""
    assert "Traceback" not in err
    assert contents(folder) == before


@pytest.mark.parametrize(
    "line",
    [
        "calibrate fit recording.npz --model ridge --out {out}/again.npz",
        "calibrate evaluate model.npz recording.npz",
        "register points points.npy points.npy",
        "register block capture.npz",
        "plan transfer waypoints.npy",
        "plan suture",
        "study suture",
        "station show suture",
        "station list",
    ],
)
def test_json_is_one_object_and_nothing_else(tmp_path, monkeypatch, capsys, line):
    code, out, _ = trocar(monkeypatch, capsys, f"{line.format(out=tmp_path)} --json")
    assert code == 0
    assert isinstance(json.loads(out), dict)
    assert out.count("\n") == 1


def test_an_absent_block_is_code_1_with_an_object(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    np.save("plate.npy", np.random.default_rng(0).uniform((-0.05, -0.05, 0.5), (0.05, 0.05, 0.5001), (3000, 3)))
    code, out, err = trocar(monkeypatch, capsys, "register block plate.npy --unit m --json")
    assert code == 1
    assert json.loads(out)["found"] is False
    assert err == ""


def test_the_installed_command_prints_no_traceback(folder):
    command = [sys.executable, "-c", "from trocar.cli import main; main()", "station", "show", "nan.toml"]
    result = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=os.environ, check=False)
    assert result.returncode == 2
    assert re.fullmatch(r"trocar: [^\n]+\n", result.stderr)
