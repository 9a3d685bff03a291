"""``trocar report DIR --trial K``: the report of one trial."""

import json

import pytest

from pages import assert_fit_to_show
from synthetic import config, keep, synthetic_trial
from trocar.eval.folder import load_trials, open_folder

RUN = config(seed=3, sessions=2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run's folder with two trials, in the second of which a transfer failed."""
    folder = tmp_path_factory.mktemp("run")
    open_folder(RUN, folder)
    for session, failures in enumerate(({}, {1: "DROPPED"})):
        keep(synthetic_trial(RUN, failures=failures, session=session), folder)
    return folder


def test_it_lies_beside_the_trial_and_what_is_of_the_run_stays(folder, trocar):
    before = {path for path in folder.rglob("*") if path.is_file()}
    code, out, err = trocar("report", folder, "--session", 1, "--trial", 0, "--json")
    summary = json.loads(out)
    assert code == 0, err
    assert (summary["trials"], summary["succeeded"], summary["attempted"]) == (1, 11, 12)
    beside = folder / "session_01" / "trial_000"
    page = assert_fit_to_show(beside / "report.html")
    assert "11 of 12" in page.text and "Session 1, trial 0 step by step" in page.text
    assert "--sessions 2 --trials 1 --seed 3" in page.text, "the command of the whole run"
    made = {path for path in folder.rglob("*") if path.is_file()} - before
    assert all(beside in path.parents for path in made)
    assert {path.name for path in made} >= {
        *("summary.json", "storyboard.png", "paths.png", "timechart.png", "replay.html"),
        "session_01_trial_000_goal_02.png",
    }
    assert len(load_trials(folder)[0]) == 2


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--session", 1, "--trial", 7), "no trial 7 of session 1; choose one of --session 0 --trial 0, --session 1"),
        (("--session", 1), "--session 1 is given without --trial"),
        (("--camera", "left"), "--camera left is given without --mp4"),
    ],
)
def test_a_trial_that_is_not_there_is_one_sentence(folder, trocar, words, named):
    code, _, err = trocar("report", folder, *words)
    assert code == 2 and named in " ".join(err.split())


def test_a_trial_of_another_run_is_refused(folder, trocar):
    path = keep(synthetic_trial(config(seed=9), index=3), folder)
    try:
        code, _, err = trocar("report", folder, "--trial", 3)
    finally:
        path.unlink()
    assert code == 2 and "is not a trial of this run" in " ".join(err.split())


def test_a_film_of_a_camera_lies_beside_its_trial_and_a_wrong_camera_is_told_at_once(
    folder, trocar, unpictured, monkeypatch
):
    pytest.importorskip("av")
    filmed = []
    monkeypatch.setattr(
        "trocar.report.video.film_camera", lambda images, duration_s, path, tick: filmed.append((duration_s, path))
    )
    code, _, err = trocar("report", folder, "--mp4", "--camera", "overhead")
    assert code == 2 and "camera 'overhead' is unknown; the trial has no camera images" in " ".join(err.split())
    assert not (folder / "report.html").exists(), "told before anything is drawn"
    monkeypatch.setattr("trocar.report.video.images_of", lambda trial, camera: [trial.about["session"], camera])
    words = ("--session", 1, "--trial", 0, "--mp4", "--camera", "overhead")
    code, _, err = trocar("report", folder, *words)
    path = folder / "session_01" / "trial_000" / "video_overhead.mp4"
    assert code == 0 and str(path) in "".join(err.split()), err
    assert filmed == [(60.0, path)]
