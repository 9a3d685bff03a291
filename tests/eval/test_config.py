"""What a run is: it can be handed on, and tells itself from others."""

import os
import pickle
import subprocess
import sys
from importlib.resources import files

import numpy as np
import pytest

from synthetic import config
from trocar.errors import InvalidInput, TrocarError
from trocar.eval.config import MAX_TRIALS, RunConfig, fingerprint
from trocar.lab import station_text
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.tasks.suture.task import CircleSutures

CIRCLES = RunConfig(CircleSutures())


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
        ({"method": "uncalibrated", "calibration": "joints"}, "--calibration joints has no effect"),
        ({"method": "uncalibrated", "new_session": True}, "--new-session mounts the instruments again after a"),
        ({"method": "uncalibrated", "prior": "fleet"}, "--prior fleet has no play model that could start from it"),
        ({"method": "adaptive", "calibration": "joints"}, "--calibration joints has no effect"),
        ({"method": "adaptive", "model": "ridge"}, "--method adaptive learns model 'play', not 'ridge'"),
        ({"method": "best", "model": "ridge", "prior": "fleet"}, "has no play model that could start from it"),
    ],
)
def test_an_option_that_would_have_no_effect_is_refused(options, words):
    with pytest.raises(InvalidInput, match=words):
        RunConfig(PegTransfer(), **options)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"calibration": "guesses"}, "calibration 'guesses' is unknown; choose one of images, joints"),
        ({"plugins": ("nowhere.py",)}, "plugin 'nowhere.py' is not a Python file"),
        ({"prior": "no_such_file.npz"}, "no_such_file.npz' does not exist"),
    ],
)
def test_what_there_is_not_is_refused(bad, words):
    with pytest.raises(TrocarError, match=words):
        config(**bad).about()


def test_what_is_not_given_follows_from_task_and_method():
    usual = {name: RunConfig(PegTransfer(), method=name) for name in ("", "uncalibrated", "adaptive", "optimized")}
    assert {name: (run.model, run.calibration, run.prior, run.planner) for name, run in usual.items()} == {
        "": ("play", "images", "none", "spline"),
        "uncalibrated": ("", "", "none", "spline"),
        "adaptive": ("play", "", "fleet", "spline"),
        "optimized": ("play", "images", "none", "sqp"),
    }
    assert {run.station for run in usual.values()} == {"peg-transfer"} and CIRCLES.station == "suture"
    assert {(run.arms, run.perception) for run in usual.values()} == {(("psm1",), "depth")}
    said = {name: [run.about()[key] for key in ("model", "calibration", "prior")] for name, run in usual.items()}
    assert said["adaptive"] == [None, None, "fleet"] and said["uncalibrated"] == [None] * 3
    assert said[""] == ["play", "images", "none"] and usual[""].method == "calibrated"


def test_every_choice_makes_another_run_but_not_how_many_trials(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text(station_text("peg-transfer").replace("133.2", "133.3"))
    (plugin := tmp_path / "plugin.py").write_text("VALUE = 1\n")
    runs = [
        RunConfig(PegTransfer(transfers=1), calibration="joints"),
        RunConfig(PegTransfer(budget_s=100.0), calibration="joints"),
        CIRCLES,
        *(config(**{name: True}) for name in ("new_session", "refit_offsets", "flawless_camera")),
        config(difficulty="recorded"),
        config(flaws=("jaw=1deg",)),
        config(prior="fleet"),
        *(config(**choice) for choice in ({"seed": 1}, {"method": "uncalibrated"}, {"model": "ridge"})),
        config(calibration="images"),
        config(station=str(mine)),
        config(plugins=(str(plugin),)),
    ]
    found = [run.fingerprint for run in (config(), *runs)]
    assert len(set(found)) == len(found)
    assert config(sessions=3, trials=5).fingerprint == config().fingerprint
    (prior := tmp_path / "prior.npz").write_bytes((files("trocar.calibration.fleet") / "fleet.npz").read_bytes())
    of_file = config(prior=str(prior)).fingerprint
    prior.write_bytes(prior.read_bytes() + bytes(1))  # more bytes after a zip's end do not matter to it
    assert config(prior=str(prior)).fingerprint != of_file
    plugin.write_text("VALUE = 2\n")
    assert config(plugins=(str(plugin),)).fingerprint != found[-1]


def test_what_is_unusual_about_a_run_is_told():
    assert config(seed=1).unusual == {"calibration": "joints", "difficulty": ["mild"]}
    assert RunConfig(PegTransfer(transfers=3), method="best").unusual == {"transfers": 3}


def test_a_number_of_numpy_is_an_option_like_pythons():
    one, other = (RunConfig(PegTransfer(transfers=kind(3), budget_s=kind(99))) for kind in (np.int64, int))
    assert one.fingerprint == other.fingerprint


def test_a_fingerprint_is_the_same_in_another_process_and_in_any_order():
    assert fingerprint({"a": 1, "b": {"c": 2, "d": 3}}) == fingerprint({"b": {"d": 3, "c": 2}, "a": 1})
    code = (
        "from trocar.eval.config import RunConfig; from trocar.tasks.peg_transfer.task import PegTransfer;"
        "print(RunConfig(PegTransfer(), seed=4, calibration='joints', difficulty='mild').fingerprint)"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "77"}
    result = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == config(seed=4).fingerprint


def test_streams_of_randomness_differ_by_seed_session_and_purpose():
    drawn = {
        config(seed=seed).rng(session, stream).integers(2**62)
        for seed in range(2)
        for session in range(2)
        for stream in range(3)
    }
    assert len(drawn) == 12 and config(seed=1).rng(1, 2).integers(2**62) in drawn
