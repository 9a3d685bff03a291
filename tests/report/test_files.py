"""What is written beside the trials of a run: summary, pictures, replay, page."""

from dataclasses import replace
from types import SimpleNamespace

import matplotlib.image
import numpy as np
import pytest

import trocar.view.replay
from pages import Page
from synthetic import config, keep, synthetic_trial, unmarked
from trocar.eval import TaskReport
from trocar.eval.folder import load_trials, open_folder
from trocar.report import files
from trocar.report.files import draw_trial, report_of, write_report
from trocar.tasks.peg_transfer.report import PegReport

RUN = config(seed=3, trials=2)


def test_a_task_that_is_not_registered_here_has_a_plain_report():
    trial = synthetic_trial(RUN)
    assert type(report_of(replace(trial, about=trial.about | {"task": "knitting"}))) is TaskReport
    moments = TaskReport().moments(synthetic_trial(RUN, failures={1: "NOT_PLACED"}))
    assert moments[:3] == [("start", 0.0), ("transfer 1: done", 5.0), ("transfer 2: not placed", 10.0)]
    assert moments[-1] == ("end", 60.0)


def test_the_storyboard_of_a_trial_shows_its_moments(tmp_path):
    trial = synthetic_trial(failures={3: "DROPPED"})
    image = matplotlib.image.imread(draw_trial(trial, tmp_path / "story.png", report_of(trial)))
    assert image.shape[1] > 1000
    captions = [caption for caption, _ in PegReport().moments(trial)]
    assert captions[0] == "start" and "peg 2 to 9: dropped" in captions and "after 12 transfers" in captions
    assert "lifted" in captions and "released on peg 7" in captions


class Own(TaskReport):
    """A report of one moment."""

    def moments(self, trial):
        return [("halfway", 30.0)]


def test_a_storyboard_is_that_of_the_report_that_is_given(tmp_path, monkeypatch):
    asked, drawn = [], []

    def photographer(trial, report):
        asked.append(report)
        return SimpleNamespace(picture=lambda time_s: np.full((2, 2, 3), time_s, np.uint8))

    monkeypatch.setattr(files, "photographer_of", photographer)
    monkeypatch.setattr(files, "draw_storyboard", lambda frames, path, title, **_: drawn.append((frames, title)))
    own = Own()
    draw_trial(synthetic_trial(RUN), tmp_path / "own.png", own)
    ((((caption, image),), title),) = drawn
    assert (caption, image.max(), asked) == ("halfway", 30, [own])
    assert title == "peg-transfer, unilateral, calibrated, session 0, trial 0 of seed 3 (simulated)"


def test_a_run_whose_record_is_lost_is_as_large_as_its_trials_span(tmp_path, unpictured):
    trials = [synthetic_trial(RUN, index, session=session) for session, index in ((0, 0), (0, 2), (1, 1))]
    write_report(tmp_path, trials)
    assert "--sessions 2 --trials 3 --seed 3" in Page(tmp_path / "report.html").text
    open_folder(RUN, tmp_path / "kept")
    write_report(tmp_path / "kept", trials[:1], into=tmp_path / "elsewhere")
    assert "--sessions 1 --trials 2 --seed 3" in Page(tmp_path / "elsewhere" / "report.html").text
    assert not (tmp_path / "kept" / "report.html").exists()


def test_the_replay_is_of_the_first_trial_and_in_the_colours_for_people(tmp_path, unpictured, monkeypatch):
    shown = []
    monkeypatch.setattr(files, "find_spec", lambda module: module == "viser")
    monkeypatch.setattr(
        trocar.view.replay, "write_replay", lambda replay, path: shown.append(replay) or path.touch() or path
    )
    trials = [synthetic_trial(RUN, 0), synthetic_trial(RUN, 1)]
    before = {solid.body: solid.rgba for solid in trials[0].replay().solids}
    _, written = write_report(tmp_path, trials)
    (replay,) = shown
    moved, first, second = (one.T_world_body["block0"].matrix for one in (replay, *(t.replay() for t in trials)))
    assert np.array_equal(moved, first) and not np.array_equal(moved, second)
    assert tmp_path / "replay.html" in written
    after = {solid.body: solid.rgba for solid in replay.solids}
    assert after.pop("block0") == (*PegReport.colours["block"], before.pop("block0")[3]) and after == before


@pytest.mark.slow
def test_a_report_writes_what_it_names_and_the_same_again(tmp_path):
    trials = [
        synthetic_trial(RUN, 0, {2: "DROPPED", 5: "NOT_PLACED", 7: "NO_BLOCK"}),
        synthetic_trial(RUN, 1, {1: "DROPPED"}),
    ]
    open_folder(RUN, tmp_path)
    for trial in trials:
        keep(trial, tmp_path)
    summary, files = write_report(tmp_path, *load_trials(tmp_path))
    written = ("summary.json", "storyboard.png", "paths.png", "timechart.png")
    first = [(tmp_path / name).read_bytes() for name in written]
    assert unmarked(tmp_path / "summary.json") == summary
    assert all(file.stat().st_size > 0 for file in files)
    names = {"summary.json", "storyboard.png", "paths.png", "timechart.png", "replay.html", "report.html"}
    assert names <= {file.name for file in files}
    write_report(tmp_path, *load_trials(tmp_path))
    assert [(tmp_path / name).read_bytes() for name in written] == first, "of the trials, not of the machine"
    page = (tmp_path / "report.html").read_text()
    assert "paths.png" in page and "20 of 24" in page and "replay.html" in page
