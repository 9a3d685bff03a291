"""Plans and their folders: what is refused, what goes on where it stopped."""

import json

import numpy as np
import pytest

from synthetic import synthetic_trial
from trocar.calibration.excitation import random_smooth_path
from trocar.errors import TrocarError
from trocar.trials import Plan, open_folder, prepare, trial_file


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"task": "knitting"}, "task 'knitting'.*peg-transfer"),
        ({"variant": "sideways"}, "variant 'sideways'.*unilateral"),
        ({"method": "magic"}, "method 'magic'.*uncalibrated, calibrated"),
        ({"model": "oracle"}, "model 'oracle'.*play"),
        ({"trials": 0}, "trials is 0.*1 or more"),
        ({"seed": -1}, "seed is -1.*0 or more"),
        ({"refit_offsets": True, "method": "uncalibrated"}, "no model to refit"),
    ],
)
def test_a_plan_that_cannot_be_run_is_refused(bad, words):
    with pytest.raises(TrocarError, match=words):
        Plan(**bad)


def test_a_new_folder_has_everything_to_do(tmp_path):
    assert open_folder(Plan(trials=3), tmp_path / "new" / "run") == [0, 1, 2]


def test_finished_trials_are_not_done_again(tmp_path):
    plan = Plan(trials=3)
    open_folder(plan, tmp_path)
    synthetic_trial(plan).save(trial_file(tmp_path, 1))
    assert open_folder(plan, tmp_path) == [0, 2]
    assert open_folder(Plan(trials=5), tmp_path) == [0, 2, 3, 4]


@pytest.mark.parametrize("other", [{"seed": 1}, {"method": "uncalibrated"}, {"model": "ridge"}, {"new_session": True}])
def test_another_plan_is_refused_and_the_folder_stays(tmp_path, other):
    open_folder(Plan(), tmp_path)
    before = (tmp_path / "run.json").read_bytes()
    with pytest.raises(TrocarError, match=f"another run.*{next(iter(other))}.*--out"):
        open_folder(Plan(**other), tmp_path)
    assert (tmp_path / "run.json").read_bytes() == before


@pytest.mark.parametrize("content", ["", "{", "[1, 2]", "7"])
def test_a_damaged_plan_is_named(tmp_path, content):
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(TrocarError, match=r"--out") as caught:
        open_folder(Plan(), tmp_path)
    assert str(tmp_path) in str(caught.value)


def test_a_folder_that_is_a_file_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(TrocarError, match="cannot use folder"):
        open_folder(Plan(), tmp_path / "file")


def test_the_plan_is_kept(tmp_path):
    open_folder(Plan(seed=4, trials=2), tmp_path)
    kept = json.loads((tmp_path / "run.json").read_text())
    assert kept["seed"] == 4 and kept["trials"] == 2


def mean_miss(plan: Plan, folder) -> np.ndarray:
    """Return the mean (3,) by which the model misses the cables of the trials, rad."""
    session, models = prepare(plan, folder)
    plant, model = session.plants["psm1"], models["psm1"]
    q = random_smooth_path(session.arms["psm1"], np.random.default_rng(99), 300)
    return (model.predict(q) - plant.run(q))[:, 3:].mean(axis=0)


def test_the_recording_and_the_trials_share_a_session_unless_a_new_one_is_drawn(tmp_path):
    cells = {"same": {}, "new": {"new_session": True}, "refitted": {"new_session": True, "refit_offsets": True}}
    for seed in (0, 2):
        missed = {}
        for name, options in cells.items():
            folder = tmp_path / f"{name}{seed}"
            folder.mkdir()
            missed[name] = np.linalg.norm(mean_miss(Plan(seed=seed, model="play", **options), folder))
        assert missed["same"] < 5e-3
        assert missed["new"] > 3 * missed["same"]
        assert missed["refitted"] < 10e-3


def test_a_fitted_model_is_kept_for_the_next_start(tmp_path, monkeypatch):
    plan = Plan(model="offset")
    session, models = prepare(plan, tmp_path)
    monkeypatch.setattr("trocar.trials.run.record_motion", None)
    again, kept = prepare(plan, tmp_path)
    q = random_smooth_path(session.arms["psm1"], np.random.default_rng(1), 50)
    assert np.array_equal(kept["psm1"].predict(q), models["psm1"].predict(q))
    assert all(np.array_equal(again.plants[a].offset, session.plants[a].offset) for a in session.plants)


def test_uncalibrated_fits_nothing(tmp_path):
    _, models = prepare(Plan(method="uncalibrated"), tmp_path)
    assert models == {}
    assert list(tmp_path.iterdir()) == []
