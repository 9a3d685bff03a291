"""What a policy is shown of a trial, frame by frame."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from made_episodes import short
from trocar.arms import fk
from trocar.errors import InvalidInput
from trocar.geometry import SE3
from trocar.learn.episode import ACTION, DONE, PHASE, REWARD, STATE, STEP, episode_of

TICK_S = 0.01


@pytest.fixture(scope="module")
def trial():
    found = short()
    beside = {name: SE3.from_parts(translation_m=[0.01, 0, 0]) @ T for name, T in found.scenery.T_world_base.items()}
    return replace(found, scenery=replace(found.scenery, T_world_base_registered=beside))


def at(trial, kind, time_s):
    """Joints and jaw of psm1 at a time, between two ticks."""
    rows = trial.arrays[f"{kind}_psm1"].astype(float)
    return np.array([np.interp(time_s, TICK_S * np.arange(len(rows)), rows[:, k]) for k in range(7)])


@pytest.mark.parametrize(("commanded", "kind"), [(False, "desired"), (True, "commanded")])
def test_a_frame_has_what_encoders_read_and_what_is_asked_for_by_the_next_frame(trial, commanded, kind):
    episode = episode_of(trial, commanded=commanded)
    assert episode.frames == 91 and episode.columns[STATE].shape == episode.columns[ACTION].shape == (91, 8)
    base = trial.scenery.T_world_base_registered["psm1"]
    for frame in (0, 31, 90):
        for column, row in (
            (STATE, at(trial, "measured", frame / 30)),
            (ACTION, at(trial, kind, min((frame + 1) / 30, 3.0))),
        ):
            tip = base @ fk(trial.scenery.arms["psm1"], row[:6])
            assert_allclose(episode.columns[column][frame, :3], tip.translation_m, atol=1e-7)
            assert_allclose(episode.columns[column][frame, 7], row[6], atol=1e-6)


def test_truth_is_there_only_if_it_is_asked_for_and_comes_from_the_true_base(trial):
    assert not [key for key in episode_of(trial).columns if "truth" in key]
    episode = episode_of(trial, truth=True)
    tip = trial.scenery.T_world_base["psm1"] @ fk(trial.scenery.arms["psm1"], at(trial, "true", 1.0)[:6])
    assert_allclose(episode.columns["truth.poses"][30, :3], tip.translation_m, atol=1e-6)
    assert_allclose(episode.columns["truth.joints"][30], at(trial, "true", 1.0), atol=1e-6)
    block = trial.arrays["body_block0"][100]
    assert_allclose(episode.columns["truth.bodies"][30], block[[0, 1, 2, 4, 5, 6, 3]])
    assert episode.names["truth.bodies"][3:7] == [f"block0.orientation.{axis}" for axis in "xyzw"]
    assert episode.names["truth.poses"][0] == "psm1_true.position.x"
    with pytest.raises(InvalidInput, match="session 0, trial 0 is of real arms"):
        episode_of(replace(trial, about={**trial.about, "robot": "crtk"}), truth=True)


def test_steps_phases_and_rewards_say_what_was_done_when(trial):
    episode = episode_of(trial)
    steps = [episode.steps[k] for k in episode.columns[STEP][:, 0]]
    assert steps[0] == "between goals" and steps[-1] == "between goals"
    source, target = trial.scores[0]["source"], trial.scores[0]["target"]
    assert set(steps[15:60]) == {f"psm1: transfer 1 of 1 (source {source}, target {target})"}
    phases = [episode.phases[k] for k in episode.columns[PHASE][:, 0]]
    for frame in (1, 20, 50, 90):
        under_way = [s.name for s in trial.spans if s.start_s <= frame / 30 < s.end_s]
        assert phases[frame] == (under_way or ["other"])[0]
    assert np.flatnonzero(episode.columns[REWARD][:, 0]).tolist() == [60]
    assert np.flatnonzero(episode.columns[DONE][:, 0]).tolist() == [90]


def test_success_and_failures_are_told():
    assert episode_of(short()).about["success"] is True
    failed = episode_of(short(success=False))
    assert failed.about["success"] is False and failed.about["failures"] == ["DROPPED"]
    assert not failed.columns[REWARD].any()
    stopped = episode_of(replace(short(), ended="OUT_OF_TIME"))
    assert stopped.about["success"] is False and stopped.about["ended"] == "OUT_OF_TIME"


def test_a_trial_of_one_frame_is_refused(trial):
    tiny = replace(trial, arrays={k: v[:3] if k != "T_world_board" else v for k, v in trial.arrays.items()})
    with pytest.raises(InvalidInput, match="shorter than two frames"):
        episode_of(tiny)
