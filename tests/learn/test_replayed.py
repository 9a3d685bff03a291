"""Recorded commands, replayed in a simulated cell."""

import json
from dataclasses import replace

import numpy as np
import pytest

from made_episodes import short
from trocar.arms import MOTION_LIMITS, fk
from trocar.errors import InvalidInput
from trocar.eval.trial import Trial
from trocar.geometry import SE3
from trocar.learn import replayed
from trocar.learn.dataset import export_lerobot
from trocar.learn.episode import ACTION, episode_of
from trocar.learn.read import Recorded
from trocar.learn.replayed import REPLAYED, Source, deviations

VELOCITY = MOTION_LIMITS["paper"].velocity


@pytest.fixture
def data(tmp_path):
    export_lerobot([short()], tmp_path / "data")
    return tmp_path / "data"


def test_frames_come_as_recorded_and_later_only_where_limits_ask_for_it():
    rows = np.zeros((5, 7))
    rows[3:, 1] = 2 * VELOCITY[1] / 30  # a step that would be twice too fast
    times_s = replayed._times({"a": rows}, 30.0, {"a": VELOCITY})
    np.testing.assert_allclose(np.diff(times_s) * 30, [1, 1, 2 * replayed.SLOWER, 1])
    both = replayed._times({"a": rows, "slow": rows}, 30.0, {"a": VELOCITY, "slow": VELOCITY / 2})
    np.testing.assert_allclose(np.diff(both) * 30, [1, 1, 4 * replayed.SLOWER, 1], err_msg="each has its own limits")


def test_the_lag_of_the_recording_is_found():
    places = np.random.default_rng(0).normal(size=(50, 8)).cumsum(axis=0)
    for lag in (0, 1, 3):
        assert replayed._lag(Recorded(30.0, {"a": places[lag:]}, {"a": places[: 50 - lag]})) == lag
    assert replayed._lag(Recorded(30.0, {"a": places}, {})) == 0


def replay_of(trial, slower=1.0, off_m=0.0):
    """A trial whose true tip was where it was recorded, played slower, but beside it by so much along x."""
    episode = episode_of(trial)
    names = {"start_s": 0.0, "factor": slower, "frames_s": [k / 30 for k in range(episode.frames)]}
    rows = trial.arrays["measured_psm1"].astype(float)
    at_s = np.arange(int(slower * len(rows)) + 1) * 0.01 / slower + 1 / 30
    played = np.column_stack([np.interp(at_s, 0.01 * np.arange(len(rows)), rows[:, k]) for k in range(7)])
    beside = {n: SE3.from_parts(translation_m=[off_m, 0, 0]) @ T for n, T in trial.scenery.T_world_base.items()}
    scenery = replace(trial.scenery, T_world_base=beside)
    arrays = {"true_psm1": played, "measured_psm1": played}
    return replace(trial, arrays=arrays, scenery=scenery, events=[{"name": REPLAYED, "time_s": 0.0, **names}])


@pytest.mark.parametrize("slower", [1.0, 2.5])
def test_how_far_a_replay_was_off_is_measured_on_its_own_clock(data, slower):
    found, times = deviations(replay_of(short(), slower, off_m=4e-3), Source(str(data)))
    assert found["psm1"].tip_rms_m == pytest.approx(4e-3, abs=1e-4)
    assert found["psm1"].tip_end_m == pytest.approx(4e-3, abs=1e-4)
    assert abs(found["psm1"].jaw_end_rad) < 1e-2
    assert times["lag_s"] == pytest.approx(1 / 30) and times["recorded_s"] == pytest.approx(3.0)
    assert times["replayed_s"] == pytest.approx(slower * 3.0, rel=1e-3)


def test_a_replay_that_was_stopped_says_why(data):
    stopped = replace(short(), reason="psm1 leaves its box")
    with pytest.raises(InvalidInput, match="psm1 leaves its box"):
        deviations(stopped, Source(str(data)))


@pytest.mark.slow
def test_commands_are_replayed_on_cables_that_err_and_kept_as_a_trial(trocar, data, tmp_path):
    words = ("import", "lerobot", data, "--task", "peg-transfer", "--seed", 2, "--out", tmp_path / "out", "--json")
    code, out, _ = trocar(*words)
    said = json.loads(out)
    assert code == 0 and (said["attempted"], said["succeeded"]) == (12, 0)
    assert 3e-4 < said["arms"]["psm1"]["tip_rms_m"] < 0.03
    trial = Trial.load(tmp_path / "out" / "session_00" / "trial_000.npz")
    assert trial.finished and trial.about["method"] == "recorded"
    told = next(event for event in trial.events if event["name"] == REPLAYED)
    ticks = np.rint((told["start_s"] + told["factor"] * np.array(told["frames_s"])) / 0.01).astype(int)
    base = trial.scenery.T_world_base_registered["psm1"]
    tips = base @ fk(trial.scenery.arms["psm1"], trial.arrays["desired_psm1"][ticks, :6].astype(float))
    asked = episode_of(short()).columns[ACTION]
    np.testing.assert_allclose(tips.translation_m, asked[:, :3], atol=5e-4)
    again = json.loads(trocar(*words)[1])
    assert again["arms"] == said["arms"], "what is kept is not played again"
    export_lerobot([short()], data, commanded=True)
    code, _, err = trocar(*words)
    assert code == 2 and "holds another run" in err, "another episode of this name is another replay"


@pytest.mark.slow
def test_data_that_cannot_be_replayed_is_refused_in_a_sentence(trocar, data, tmp_path):
    words = ("import", "lerobot", data, "--task", "peg-transfer", "--out", tmp_path / "out")
    for more, says in (
        (("--episode", 3), "--episode"),
        (("--frame", "moon"), "--frame"),
        (("--task", "nothing"), "nothing"),
    ):
        code, _, err = trocar(*words, *more)
        assert code == 2 and says in err and err.count("Traceback") == 0, more
    (data / "meta" / "info.json").unlink()
    code, _, err = trocar(*words)
    assert code == 2 and "has no meta/info.json" in err
