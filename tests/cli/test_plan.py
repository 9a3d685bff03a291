import json
import sys

import numpy as np
import pytest

from trocar.arms import ARMS, ik
from trocar.cli import main
from trocar.geometry import SE3, SO3


def transfer_waypoints():
    """Grasp, lifted, over the target, lowered: tips as on the board, turned a little on the way."""
    places_m = [
        [0.140, -0.020, -0.155],
        [0.140, -0.020, -0.115],
        [0.100, 0.020, -0.115],
        [0.100, 0.020, -0.145],
    ]
    turns = SO3.axis("z", [0.5, 0.5, -0.2, -0.2])
    return ik(ARMS["psm-classic"], SE3.from_parts(turns, places_m))


FOUR = transfer_waypoints()


@pytest.fixture
def run(monkeypatch, capsys):
    def command(*words):
        monkeypatch.setattr(sys, "argv", ["trocar", "plan", "transfer", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            main()
        out = capsys.readouterr()
        return stop.value.code or 0, out.out, out.err

    return command


@pytest.mark.parametrize("suffix", ["npy", "npz"])
def test_json_has_the_promised_keys(run, tmp_path, suffix):
    path = tmp_path / f"four.{suffix}"
    if suffix == "npy":
        np.save(path, FOUR)
    else:
        np.savez(path, waypoints=np.stack([FOUR, FOUR[::-1]]))
    code, out, _ = run(path, "--planner", "spline", "--json")
    assert code == 0
    answer = json.loads(out)
    assert answer["planner"] == "spline"
    motions = answer["motions"]
    assert len(motions) == (1 if suffix == "npy" else 2)
    assert answer["mean_duration_s"] == pytest.approx(np.mean([m["duration_s"] for m in motions]))
    for motion in motions:
        assert 0 < motion["bound_s"] < motion["duration_s"] < 1.5 * motion["bound_s"]
        assert motion["compute_ms"] > 0
        assert 0 < motion["max_velocity_ratio"] <= 1 + 1e-9
        assert 0.9 < motion["max_acceleration_ratio"] <= 1 + 1e-9
        assert 0 < motion["vertical_deviation_m"] < 2e-3


def test_table_says_what_left_the_nominal_range(run, tmp_path):
    beyond = FOUR.copy()
    beyond[0, 2] = 0.2403
    np.save(tmp_path / "four.npy", beyond)
    code, out, _ = run(tmp_path / "four.npy")
    assert code == 0
    assert "leaves the nominal range" in out
    assert "acceleration" in out


def bad_file(kind, path):
    if kind == "text":
        path.write_text("no numbers here")
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "truncated":
        np.save(path, FOUR)
        path.write_bytes(path.read_bytes()[:150])
    elif kind == "shape":
        np.save(path, FOUR[:3])
    elif kind == "words":
        np.save(path, np.array(["a", "b"]))
    elif kind == "nan":
        np.save(path, np.where(np.arange(6) == 2, np.nan, FOUR))
    elif kind == "range":
        np.save(path, FOUR + np.array([0, 0, 0.1, 0, 0, 0]))
    elif kind == "same":
        np.save(path, FOUR[[0, 1, 1, 3]])


@pytest.mark.parametrize("kind", ["missing", "text", "empty", "truncated", "shape", "words", "nan", "range", "same"])
def test_bad_files_are_one_sentence_and_code_2(run, tmp_path, kind):
    path = tmp_path / "four.npy"
    bad_file(kind, path)
    code, out, err = run(path, "--json")
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert str(path) in err


def test_unknown_planner_names_the_choices(run, tmp_path):
    np.save(tmp_path / "four.npy", FOUR)
    code, _, err = run(tmp_path / "four.npy", "--planner", "magic")
    assert code == 2
    assert "spline" in err
