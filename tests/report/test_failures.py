"""What failed in a run: the list on its page, and the replays to which it leads."""

from dataclasses import replace

import pytest

import trocar.view.replay
from pages import assert_fit_to_show
from synthetic import config, synthetic_trial
from trocar.eval.trial import trial_file
from trocar.report import files
from trocar.report.failures import LEAD_S, failed_goals, picked
from trocar.report.files import MOST_REPLAYS, report_of, write_report

RUN = config(seed=3, sessions=2, trials=8)


def bad(place, failures=None):
    """Return the trial of a place among those of the run, in which these goals failed, or else the third."""
    return synthetic_trial(RUN, place % 8, failures or {2: "NOT_GRASPED"}, session=place // 8)


def folder_of(trial):
    return f"session_{trial.about['session']:02d}/trial_{trial.about['index']:03d}/"


@pytest.fixture
def made(monkeypatch, unpictured):
    """Make replays of nothing but their names; return the list of them."""
    written = []

    def write(replay, path):
        written.append(path)
        path.touch()
        return path

    monkeypatch.setattr(files, "find_spec", lambda module: module == "viser")
    monkeypatch.setattr(trocar.view.replay, "write_replay", write)
    return written


def test_each_failure_leads_to_its_moment_in_the_replay_of_its_trial(tmp_path, made):
    trials = [bad(0, {4: "DROPPED"}), synthetic_trial(RUN, 1), bad(9, {1: "NOT_GRASPED", 4: "DROPPED"})]
    _, written = write_report(tmp_path, trials)
    second = folder_of(trials[2])
    assert made == [tmp_path / "replay.html", tmp_path / second / "replay.html"], "none of a trial that succeeded"
    assert set(made) <= set(written)
    page = assert_fit_to_show(tmp_path / "report.html")
    fell_s = [report_of(trial).failed_s(trial, trial.scores[4]) for trial in (trials[0], trials[2])]
    assert all(20.0 <= at_s < 25.0 for at_s in fell_s), "when the block fell, not when the transfer ended"
    assert [link for link in page.links if "#t=" in link] == [
        f"replay.html#t={fell_s[0] - LEAD_S:.2f}",
        f"{second}replay.html#t={10.0 - LEAD_S:.2f}",
        f"{second}replay.html#t={fell_s[1] - LEAD_S:.2f}",
    ]
    assert "not grasped made up: NOT_GRASPED session 1, trial 1 10.0" in page.text
    assert page.text.index("A click plays") < page.text.index("Each transfer, of 3 trials"), "failures first"
    assert "with failures: trocar" not in page.text


def test_a_script_that_stopped_comes_first_and_is_played_at_its_end(tmp_path, made):
    late = replace(synthetic_trial(RUN, 3), ended="AGENT_ERROR", reason="division by <zero>", duration_s=50.0)
    write_report(tmp_path, [bad(0), late])
    page = assert_fit_to_show(tmp_path / "report.html")
    links = [link for link in page.links if "#t=" in link]
    assert links == [f"{folder_of(late)}replay.html#t=48.00", "replay.html#t=13.00"]
    assert "the whole trial agent error division by <zero> session 0, trial 3 50.0" in page.text


def test_of_many_some_are_made_and_the_page_says_how_to_play_the_others(tmp_path, made):
    trials = [bad(place) for place in range(MOST_REPLAYS + 4)]
    write_report(tmp_path, trials)
    assert len(made) == 1 + MOST_REPLAYS
    page = assert_fit_to_show(tmp_path / "report.html")
    assert sum("#t=" in link for link in page.links) == 1 + MOST_REPLAYS
    assert "3 more trials with failures: trocar report DIR --session S --trial K makes the replay of one" in page.text

    here = trial_file(tmp_path, 1, 5).with_suffix("") / "replay.html"  # as that command does
    here.parent.mkdir(parents=True)
    here.touch()
    write_report(tmp_path, trials)
    page = assert_fit_to_show(tmp_path / "report.html")
    assert f"{folder_of(trials[-1])}replay.html#t=13.00" in page.links
    assert "2 more trials with failures" in page.text


def test_without_viser_failures_are_listed_without_links(tmp_path, unpictured):
    write_report(tmp_path, [bad(0)])
    page = assert_fit_to_show(tmp_path / "report.html")
    assert "made up: NOT_GRASPED session 0, trial 0 15.0" in page.text
    assert not any("replay" in link for link in page.links)
    assert "A click plays" not in page.text and "with failures: trocar" not in page.text


def test_which_replays_are_made_is_told(tmp_path, made):
    told = []
    write_report(tmp_path, [bad(0), bad(1)], tick=lambda *said: told.append(said))
    assert told == [("replays", 0, 2), ("replays", 1, 2)]


def test_some_of_each_kind_are_picked_and_goals_that_nobody_tried_are_none():
    trials = [bad(place, {0: "NOT_GRASPED", 1: "NOT_GRASPED", place + 4: "DROPPED"}) for place in range(2)]
    trials[1].scores[3] |= {"attempted": False, "succeeded": False}
    failed = failed_goals(trials, report_of(trials[0]))
    assert [(one.place, one.number) for one in failed] == [(0, 0), (0, 1), (0, 4), (1, 0), (1, 1), (1, 5)]
    assert [(one.place, one.number) for one in picked(failed, 3)] == [(0, 0), (0, 4), (1, 5)]
    assert picked(failed, 9) == failed
