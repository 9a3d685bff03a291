import json

import numpy as np
import pytest

from trocar.motion import PLANNERS
from waypoints import FOUR


@pytest.fixture
def run(trocar):
    return lambda *words: trocar("plan", "transfer", *words)


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
        assert motion["found"] and motion["reason"] == "" and motion["violations"] == []


@pytest.mark.parametrize("planner", PLANNERS)
def test_every_planner_plans_a_transfer(run, tmp_path, planner):
    np.save(tmp_path / "four.npy", FOUR)
    code, out, err = run(tmp_path / "four.npy", "--planner", planner, "--json")
    assert code == 0, err
    answer = json.loads(out)
    assert answer["planner"] == planner and answer["motions"][0]["found"]
    assert answer["mean_bound_s"] < answer["mean_duration_s"] < 1.5 * answer["mean_bound_s"]


def test_table_says_what_left_the_nominal_range(run, tmp_path):
    beyond = FOUR.copy()
    beyond[0, 2] = 0.2403
    np.save(tmp_path / "four.npy", beyond)
    code, out, _ = run(tmp_path / "four.npy")
    assert code == 0
    assert "leaves the nominal range" in out
    assert "acceleration" in out


PLUGIN = """
from trocar.motion import PLANNERS, TimedPath
from trocar.errors import TrocarError
from trocar.trajectory import Trajectory
import numpy as np


def hasty(problem):
    (arm,) = problem.arms.values()
    if arm.waypoints[0, 0] < 0:
        raise TrocarError("it is too late to plan")
    times = 0.1 * np.arange(len(arm.waypoints))
    path = TimedPath(Trajectory.hermite(times, arm.waypoints, 0 * arm.waypoints), times)
    return {name: path for name in problem.arms}


PLANNERS.register("hasty", hasty)
"""


@pytest.fixture
def plugin(registries, tmp_path):
    """A file with a planner that is too fast, or finds nothing."""
    path = tmp_path / "hasty.py"
    path.write_text(PLUGIN)
    return path


def test_a_motion_that_is_refused_is_told_and_the_exit_code_is_1(run, tmp_path, plugin):
    np.save(tmp_path / "four.npy", np.stack([FOUR, FOUR * [-1, 1, 1, 1, 1, 1]]))
    words = (tmp_path / "four.npy", "--plugin", plugin, "--planner", "hasty")
    code, out, _ = run(*words, "--json")
    assert code == 1
    answer = json.loads(out)
    hasty, late = answer["motions"]
    assert not hasty["found"] and hasty["duration_s"] == pytest.approx(0.3) and hasty["max_acceleration_ratio"] > 2
    assert any("of its acceleration limit" in violation for violation in hasty["violations"])
    assert not late["found"] and late["duration_s"] is None and late["bound_s"] > 0
    assert late["reason"] == "planner 'hasty' found no motion: it is too late to plan"
    assert answer["mean_duration_s"] is None
    code, out, _ = run(*words)
    assert code == 1
    told = " ".join(out.split())
    assert "0 refused" in told and "Motion 1: planner" in told and "it is too late to plan." in told


def test_a_plugin_is_loaded_before_the_other_options_are_looked_at(run, tmp_path, plugin):
    np.save(tmp_path / "four.npy", FOUR)
    words = (tmp_path / "four.npy", "--planner", "hasty")
    code, _, err = run(*words)
    assert code == 2 and "is unknown; choose one of" in err
    code, _, err = run(*words, "--plugin", plugin)
    assert code == 1 and err == ""


def test_motions_are_saved_sample_by_sample_in_both_forms(run, tmp_path):
    np.savez(tmp_path / "two.npz", waypoints=np.stack([FOUR, FOUR[::-1]]))
    for suffix in (".csv", ".npz"):
        code, out, err = run(tmp_path / "two.npz", "--out", tmp_path / f"motions{suffix}", "--step-ms", "5", "--json")
        assert code == 0, err
    names, *rows = (line.split(",") for line in (tmp_path / "motions.csv").read_text().splitlines())
    table = np.array(rows, dtype=float)
    assert names[:5] == ["motion", "t_s", "yaw_position", "yaw_velocity", "yaw_acceleration"]
    for number, (four, motion) in enumerate(zip((FOUR, FOUR[::-1]), json.loads(out)["motions"], strict=True)):
        one = table[table[:, 0] == number]
        times, q, v = one[:, 1], one[:, 2::3], one[:, 3::3]
        assert times[0] == 0.0 and times[-1] == pytest.approx(motion["duration_s"])
        assert np.diff(times)[:-1] == pytest.approx(5e-3)
        np.testing.assert_allclose(q[[0, -1]], four[[0, -1]], atol=1e-8)
        np.testing.assert_allclose(v[[0, -1]], 0.0, atol=1e-8)
        np.testing.assert_allclose(np.gradient(q, times, axis=0)[5:-5], v[5:-5], atol=0.02)
    with np.load(tmp_path / "motions.npz") as arrays:
        assert np.array_equal(arrays["motion"], table[:, 0])
        np.testing.assert_allclose(arrays["position"], table[:, 2::3], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(arrays["acceleration"], table[:, 4::3], rtol=1e-8, atol=1e-9)
