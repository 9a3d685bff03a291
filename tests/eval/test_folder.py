"""Folders of runs: what is refused, what resumes, what belongs to another run; and what a session prepares."""

import json
import shutil

import numpy as np
import pytest

from synthetic import config, keep, synthetic_trial
from trocar.calibration.excitation import WIDE_ROWS, random_smooth_path
from trocar.calibration.models import save_model
from trocar.errors import TrocarError
from trocar.eval.config import RunConfig
from trocar.eval.folder import load_trials, open_folder, requested, still_to_do
from trocar.eval.prepare import prepare
from trocar.eval.trial import trial_file
from trocar.lab import station_text
from trocar.report.summary import summarise
from trocar.tasks.peg_transfer.report import PegReport
from trocar.tasks.peg_transfer.task import PegTransfer


def played(run, folder, *places):
    """Keep trials of a run in its folder, as if they had been played."""
    open_folder(run, folder)
    for session, index in places:
        keep(synthetic_trial(run, index, session=session), folder)


def numbers(trials):
    return [(trial.about["session"], trial.about["index"]) for trial in trials]


# What is still to do.


def test_a_new_folder_has_everything_to_do_session_by_session(tmp_path):
    folder = tmp_path / "new" / "run"
    assert open_folder(config(sessions=2, trials=3), folder) == [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)]
    kept = json.loads((folder / "run.json").read_text())
    assert (kept["sessions"], kept["trials"], kept["fingerprint"]) == (2, 3, config().fingerprint)
    assert {key: kept[key] for key in config().about()} == json.loads(json.dumps(config().about()))


def test_finished_trials_are_not_done_again_and_more_can_be_asked_for(tmp_path):
    run = config(sessions=2, trials=2)
    played(run, tmp_path, (0, 0), (1, 1))
    assert open_folder(run, tmp_path) == [(0, 1), (1, 0)]
    assert open_folder(config(sessions=1, trials=2), tmp_path) == [(0, 1)]
    assert open_folder(config(sessions=3, trials=1), tmp_path) == [(1, 0), (2, 0)]


@pytest.mark.parametrize("how", ["cut", "one byte in the middle"])
def test_a_damaged_trial_is_done_again(tmp_path, how):
    run = config(trials=2)
    played(run, tmp_path, (0, 0), (0, 1))
    path = trial_file(tmp_path, 0, 1)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content[:400] if how == "cut" else content)
    assert open_folder(run, tmp_path) == [(0, 1)]


@pytest.mark.parametrize("other", [{"seed": 1}, {"method": "uncalibrated"}, {"model": "ridge"}, {"new_session": True}])
def test_another_run_is_refused_and_the_folder_stays(tmp_path, other):
    open_folder(config(), tmp_path)
    (tmp_path / "session_00").mkdir()
    before = (tmp_path / "run.json").read_bytes()
    with pytest.raises(TrocarError, match=rf"another run.*{next(iter(other))}.*--out"):
        open_folder(config(**other), tmp_path)
    assert (tmp_path / "run.json").read_bytes() == before


def test_a_run_that_never_began_leaves_its_folder_to_others(tmp_path):
    open_folder(config(seed=1), tmp_path)
    assert open_folder(config(), tmp_path) == [(0, 0)]
    assert json.loads((tmp_path / "run.json").read_text())["seed"] == 0


def test_a_trial_of_another_run_is_refused_by_its_fingerprint(tmp_path):
    played(config(seed=1), tmp_path / "other", (0, 0))
    run = config(trials=1)
    open_folder(run, tmp_path / "mine")
    shutil.copytree(tmp_path / "other" / "session_00", tmp_path / "mine" / "session_00")
    with pytest.raises(TrocarError, match=r"trial_000\.npz' is a trial of another run; move it away"):
        open_folder(run, tmp_path / "mine")


@pytest.mark.parametrize("content", ["", "{", "[1, 2]", "7", "null"])
def test_a_damaged_record_is_named(tmp_path, content):
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(TrocarError, match="--out") as caught:
        open_folder(config(), tmp_path)
    assert str(tmp_path) in str(caught.value) and "\n" not in str(caught.value)
    assert (tmp_path / "run.json").read_text() == content


def test_a_folder_that_is_a_file_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "inside"):
        with pytest.raises(TrocarError, match=r"choose (a folder|another) with --out") as refused:
            open_folder(config(), folder)
        assert str(folder) in str(refused.value)


@pytest.mark.parametrize("number", ["1e400", "NaN", "null", "0", "-2", "1" + "0" * 4000])
def test_an_impossible_number_of_trials_in_the_record_is_unknown_in_one_sentence(tmp_path, number):
    (tmp_path / "run.json").write_text(f'{{"sessions": {number}, "trials": {number}}}')
    assert requested(tmp_path) is None
    (sentence,) = still_to_do(tmp_path, 1)
    assert sentence.endswith("cannot be read, so the run's number of trials is unknown")


# What is loaded.


def test_trials_are_loaded_in_order(tmp_path):
    played(config(sessions=2, trials=2), tmp_path, (1, 1), (0, 1), (1, 0), (0, 0))
    trials, strange = load_trials(tmp_path)
    assert numbers(trials) == [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert strange == []


@pytest.mark.parametrize("spoiled", [(0, 0), (0, 2), (1, 0)])
def test_a_damaged_trial_is_named_and_left_aside(tmp_path, spoiled):
    places = [(0, 0), (0, 1), (0, 2), (1, 0)]
    played(config(sessions=2, trials=3), tmp_path, *places)
    path = trial_file(tmp_path, *spoiled)
    path.write_bytes(path.read_bytes()[:-40])
    trials, (sentence,) = load_trials(tmp_path)
    assert numbers(trials) == [place for place in places if place != spoiled]
    assert sentence.startswith("left aside: ") and str(path) in sentence and "\n" not in sentence


@pytest.mark.parametrize("stranger", [(0, 0), (0, 2)])
def test_a_trial_of_another_run_is_named_and_not_counted_wherever_it_lies(tmp_path, stranger):
    """The folder's record says whose trials these are, not the one that happens to come first."""
    places = [(0, 0), (0, 1), (0, 2)]
    played(config(trials=3), tmp_path / "mine", *places)
    played(config(trials=3, seed=1), tmp_path / "other", stranger)
    path = trial_file(tmp_path / "mine", *stranger)
    shutil.copy(trial_file(tmp_path / "other", *stranger), path)
    trials, (sentence,) = load_trials(tmp_path / "mine")
    assert numbers(trials) == [place for place in places if place != stranger]
    assert "is of another run" in sentence and str(path) in sentence


def test_without_the_record_the_first_trial_says_whose_they_are(tmp_path):
    played(config(trials=2), tmp_path, (0, 0), (0, 1))
    played(config(seed=1), tmp_path / "other", (1, 0))
    shutil.copytree(tmp_path / "other" / "session_01", tmp_path / "session_01")
    for content in (None, "{", "[]"):
        (tmp_path / "run.json").unlink()
        if content:
            (tmp_path / "run.json").write_text(content)
        trials, (sentence,) = load_trials(tmp_path)
        assert numbers(trials) == [(0, 0), (0, 1)]
        assert "is of another run" in sentence
        (tmp_path / "run.json").touch()


def test_a_folder_in_or_around_runs_is_answered_with_theirs(tmp_path):
    for name in ("b", "a"):
        open_folder(config(sessions=2, trials=3), tmp_path / name)
        (tmp_path / name / "session_000").mkdir()
    for given, named in ((tmp_path, ("a", "b")), (tmp_path / "a" / "session_000", ("a",))):
        with pytest.raises(TrocarError, match="give the folder of a run: ") as caught:
            load_trials(given)
        assert str(caught.value).endswith("a run: " + ", ".join(str(tmp_path / name) for name in named))


def test_a_trial_that_was_copied_is_not_counted_twice(tmp_path):
    run = config(sessions=2, trials=2)
    played(run, tmp_path, (0, 0))
    for copy in ((0, 1), (1, 0)):
        path = trial_file(tmp_path, *copy)
        path.parent.mkdir(exist_ok=True)
        shutil.copy(trial_file(tmp_path, 0, 0), path)
    trials, strange = load_trials(tmp_path)
    assert numbers(trials) == [(0, 0)]
    assert len(strange) == 2
    assert all("is session 0, trial 0 under another name" in sentence for sentence in strange)
    assert open_folder(run, tmp_path) == [(0, 1), (1, 0), (1, 1)]


def test_a_folder_without_trials_is_named(tmp_path):
    with pytest.raises(TrocarError, match="does not exist; make one with `trocar run`"):
        load_trials(tmp_path / "nowhere")
    with pytest.raises(TrocarError, match="holds no trial that can be read; make some"):
        load_trials(tmp_path)
    played(config(), tmp_path, (0, 0))
    path = trial_file(tmp_path, 0, 0)
    path.write_bytes(b"")
    with pytest.raises(TrocarError, match=r"holds no trial that can be read.*trial_000\.npz") as caught:
        load_trials(tmp_path)
    assert "\n" not in str(caught.value)


# Sessions.


def mean_miss(run, folder):
    """Return the mean (3,) by which the model misses the cables of the trials, rad."""
    prepared = prepare(run, 0, folder)
    plant = prepared.session.transmissions["psm1"].plant
    q = random_smooth_path(run.laboratory.arms["psm1"].model, np.random.default_rng(99), 300)
    return (prepared.models["psm1"].predict(q) - plant.run(q))[:, 3:].mean(axis=0)


def test_recording_and_trials_share_the_mounted_instruments_unless_they_are_mounted_again(tmp_path):
    runs = {"same": {}, "new": {"new_session": True}, "refitted": {"new_session": True, "refit_offsets": True}}
    missed = {
        name: np.linalg.norm(mean_miss(config(seed=2, **options), tmp_path / name)) for name, options in runs.items()
    }
    assert missed["same"] < 5e-3
    assert missed["new"] > 3 * missed["same"]
    assert missed["refitted"] < 10e-3


@pytest.mark.parametrize("calibration", ["joints", pytest.param("images", marks=pytest.mark.slow)])
def test_a_minute_and_what_other_instruments_show_make_a_model(tmp_path, calibration):
    run = config(seed=3, prior="fleet", calibration=calibration)
    prepared = prepare(run, 0, tmp_path)
    model, plant = prepared.models["psm1"], prepared.session.transmissions["psm1"].plant
    assert 0.6 * WIDE_ROWS <= model.training.rows <= WIDE_ROWS
    q = random_smooth_path(run.laboratory.arms["psm1"].model, np.random.default_rng(99), 300)
    missed = np.sqrt(np.mean((model.predict(q) - plant.run(q))[30:, 3:] ** 2, axis=0))
    assert (missed < [0.012, 0.02, 0.02]).all()
    assert run.about()["flaws"]["cable models are fitted on"].endswith(
        "recordings of the instrument itself are left out"
    )


def test_every_session_is_another_day_and_every_day_can_be_drawn_again(tmp_path):
    run = config(sessions=2, model="offset")
    first, second = (prepare(run, number, tmp_path) for number in (0, 1))
    again = prepare(run, 1, tmp_path / "again")
    q = np.array([0.1, 0.2, 0.15, 0.3, -0.2, 0.1])
    for arm in run.laboratory.arms:
        bases = [day.session.T_world_base_registered[arm].matrix for day in (first, second, again)]
        offsets = [day.session.transmissions[arm].plant.offset for day in (first, second, again)]
        for a, b, c in (bases, offsets):
            assert not np.array_equal(a, b) and np.array_equal(b, c)
    fits = [day.models["psm1"].predict(q[None]) for day in (first, second, again)]
    assert not np.array_equal(fits[0], fits[1]) and np.array_equal(fits[1], fits[2])


def test_a_fitted_model_is_kept_for_the_next_start(tmp_path, monkeypatch):
    run = config(model="offset")
    first = prepare(run, 0, tmp_path)
    monkeypatch.setattr("trocar.eval.prepare.record_motion", None)
    again = prepare(run, 0, tmp_path)
    q = random_smooth_path(run.laboratory.arms["psm1"].model, np.random.default_rng(1), 50)
    assert np.array_equal(again.models["psm1"].predict(q), first.models["psm1"].predict(q))
    assert [p.name for p in (tmp_path / "session_00").iterdir()] == ["cables_psm1.npz"]


@pytest.mark.slow
def test_arms_are_calibrated_from_images(tmp_path, monkeypatch):
    monkeypatch.setenv("TROCAR_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("trocar.eval.prepare.IMAGES_ROWS", 40)
    monkeypatch.setattr("trocar.eval.prepare.record_motion", None)  # no joint is drawn
    counted = []
    run = config(calibration="images", model="offset", new_session=True, refit_offsets=True)
    day = prepare(run, 0, tmp_path / "one", listener=lambda arm, done, total: counted.append((arm, done, total)))
    assert counted == [("psm1", done, 82) for done in range(1, 83)]  # two rows for each image
    prepare(run, 0, tmp_path / "two", listener=lambda *_: pytest.fail("an image was taken again"))
    plant = day.session.transmissions["psm1"].plant  # of the instruments as mounted again, refitted from 30 images
    q = random_smooth_path(run.laboratory.arms["psm1"].model, np.random.default_rng(9), 200)
    missed = day.models["psm1"].predict(q)[:, 3:] - plant.run(q)[:, 3:]
    assert np.abs(missed.mean(axis=0)).max() < 0.1 < np.linalg.norm((plant.run(q) - q)[:, 3:].mean(axis=0))


def test_images_are_asked_for_only_where_they_can_be_had(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text(station_text("peg-transfer").replace("rpy_deg = [-147, 0, 0]", "rpy_deg = [0, 0, 0]"))
    assert RunConfig(PegTransfer(), station=str(mine)).calibration == "joints"
    with pytest.raises(TrocarError, match=r"does not see the spheres .*; or give --calibration joints"):
        config(station=str(mine), calibration="images")
    assert RunConfig(PegTransfer(), method="uncalibrated", station=str(mine)).about()["calibration"] is None


def test_a_model_of_another_run_is_refused(tmp_path):
    run = config(model="offset")
    model = prepare(run, 0, tmp_path).models["psm1"]
    with pytest.raises(TrocarError, match=r"cables_psm1\.npz' belongs to another run"):
        prepare(config(model="offset", seed=1), 0, tmp_path)
    save_model(model, tmp_path / "session_00" / "cables_psm1.npz")
    with pytest.raises(TrocarError, match="belongs to another run"):
        prepare(run, 0, tmp_path)


def test_a_method_without_compensation_fits_nothing(tmp_path):
    prepared = prepare(config(method="uncalibrated"), 0, tmp_path)
    assert prepared.models == {}
    assert list((tmp_path / "session_00").iterdir()) == []


def test_a_station_that_does_not_say_where_to_calibrate_is_refused_before_anything_is_written(tmp_path):
    mine = tmp_path / "mine.toml"
    text = "\n".join(line for line in station_text("peg-transfer").splitlines() if not line.startswith("calibration"))
    mine.write_text(text)
    with pytest.raises(TrocarError, match="does not define where arm 'psm1' moves during calibration"):
        config(station=str(mine))
    assert config(station=str(mine), method="uncalibrated").laboratory.arms


def test_a_report_holds_no_more_than_one_trial_in_memory(tmp_path, alive):
    played(config(trials=6), tmp_path, *((0, index) for index in range(6)))
    trials, _ = load_trials(tmp_path)
    summary = summarise(trials, PegReport())
    assert (len(trials), summary["trials"], summary["attempted"]) == (6, 6, 72)
    assert len(alive) >= 6 and max(alive) <= 1
    assert [trial.about["index"] for trial in trials[2:4]] == [2, 3]
