"""What a run is: it can be handed on, and tells itself from others."""

import pickle

import pytest

from synthetic import config
from trocar.errors import InvalidInput, TrocarError
from trocar.eval.config import MAX_TRIALS, RunConfig
from trocar.tasks.peg_transfer.task import PegTransfer


def test_a_run_can_be_handed_to_another_process():
    run = RunConfig(PegTransfer(transfers=3, budget_s=99.0), seed=4, sessions=2, model="offset", flawless_camera=True)
    again = pickle.loads(pickle.dumps(run))
    assert again.fingerprint == run.fingerprint
    assert (again.sessions, again.task) == (2, run.task)


def test_a_run_of_a_plugin_brings_it_along(registries, tmp_path):
    plugin = tmp_path / "mine.py"
    plugin.write_text("from trocar.motion import PLANNERS\nPLANNERS.register('mine', PLANNERS['spline'])\n")
    from trocar.registry import load_plugin

    load_plugin(plugin)
    run = config(planner="mine", plugins=(str(plugin),))
    assert pickle.loads(pickle.dumps(run)).fingerprint == run.fingerprint


@pytest.mark.parametrize(
    ("least", "beyond", "words"),
    [
        ({"sessions": 1}, {"sessions": 0}, "the number of sessions is 0; give 1 or more with --sessions"),
        ({"trials": 1}, {"trials": 0}, "the number of trials is 0; give 1 or more with --trials"),
        ({"seed": 0}, {"seed": -1}, "the seed is -1; give 0 or more with --seed"),
        (
            {"sessions": 100, "trials": MAX_TRIALS // 100},
            {"sessions": 100, "trials": MAX_TRIALS // 100 + 1},
            f"are more than {MAX_TRIALS} trials",
        ),
    ],
)
def test_numbers_have_bounds_that_are_allowed_themselves(least, beyond, words):
    config(**least)
    with pytest.raises(TrocarError, match=words):
        config(**beyond)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "uncalibrated", "model": "ridge"}, "--model ridge has no effect with --method uncalibrated"),
        ({"method": "uncalibrated", "calibration": "joints"}, "--calibration joints has no effect"),
        ({"method": "uncalibrated", "new_session": True}, "--new-session mounts the instruments again after a"),
        ({"method": "uncalibrated", "refit_offsets": True}, "--refit-offsets has no model to refit"),
        ({"method": "uncalibrated", "prior": "fleet"}, "--prior fleet has no play model that could start from it"),
        ({"method": "adaptive", "calibration": "joints"}, "--calibration joints has no effect"),
        ({"method": "adaptive", "model": "ridge"}, "--method adaptive learns model 'play', not 'ridge'"),
        ({"method": "best", "model": "ridge", "prior": "fleet"}, "has no play model that could start from it"),
        (
            {"method": "best", "calibration": "guesses"},
            "calibration 'guesses' is unknown; choose one of images, joints",
        ),
    ],
)
def test_an_option_that_would_have_no_effect_is_refused(options, words):
    with pytest.raises(InvalidInput, match=words):
        RunConfig(PegTransfer(), **options)


def test_what_is_not_given_follows_from_task_and_method():
    usual = {name: RunConfig(PegTransfer(), method=name) for name in ("", "uncalibrated", "adaptive", "optimized")}
    assert {name: (run.model, run.calibration, run.prior, run.planner) for name, run in usual.items()} == {
        "": ("play", "images", "none", "spline"),
        "uncalibrated": ("", "", "none", "spline"),
        "adaptive": ("play", "", "fleet", "spline"),
        "optimized": ("play", "images", "none", "sqp"),
    }
    said = {name: [run.about()[key] for key in ("model", "calibration", "prior")] for name, run in usual.items()}
    assert said["adaptive"] == [None, None, "fleet"] and said["uncalibrated"] == [None] * 3
    assert said[""] == ["play", "images", "none"] and usual[""].method == "calibrated"


def test_only_what_changes_trials_tells_runs_apart():
    run = config(seed=1)
    assert config(seed=1, sessions=5, trials=3).fingerprint == run.fingerprint
    others = [config(seed=2), config(seed=1, new_session=True), config(seed=1, flaws=("jaw=1deg",))]
    assert len({one.fingerprint for one in (run, *others)}) == 4
    assert run.unusual == {"calibration": "joints", "difficulty": ["mild"]}
    assert RunConfig(PegTransfer(transfers=3), method="best").unusual == {"transfers": 3}


def test_streams_of_randomness_differ_by_seed_session_and_purpose():
    drawn = {
        config(seed=seed).rng(session, stream).integers(2**62)
        for seed in range(2)
        for session in range(2)
        for stream in range(3)
    }
    assert len(drawn) == 12 and config(seed=1).rng(1, 2).integers(2**62) in drawn
