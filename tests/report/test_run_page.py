"""The page of a run, and the command printed on it, which repeats the run."""

import shlex
from dataclasses import replace

import pytest
import typer
from typer.testing import CliRunner

from pages import assert_fit_to_show
from synthetic import config, keep, synthetic_trial, unmarked
from trocar.cli import app
from trocar.eval import TASKS
from trocar.eval import folder as trials_folder
from trocar.eval.folder import load_trials, open_folder
from trocar.report import files
from trocar.report.files import kept_pictures, write_report
from trocar.report.run_page import command_of

RUN = config(seed=3, sessions=2)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run's folder, its page and its summary: two trials, in the second of which three transfers failed."""
    folder = tmp_path_factory.mktemp("run")
    open_folder(RUN, folder)
    failures = {1: "DROPPED", 4: "NOT_GRASPED", 5: "NOT_GRASPED"}
    for session, failed in enumerate(({}, failures)):
        keep(synthetic_trial(RUN, failures=failed, session=session), folder)
    most, files.MOST_FAILED = files.MOST_FAILED, 2
    try:
        write_report(folder, *load_trials(folder))
    finally:
        files.MOST_FAILED = most
    return folder, assert_fit_to_show(folder / "report.html"), unmarked(folder / "summary.json")


def test_the_headline_has_the_summary_s_figures(run):
    _, page, summary = run
    low, high = summary["success_ci95"]
    for figure in (
        f"{summary['succeeded']} of {summary['attempted']}",
        f"{100 * summary['success_rate']:.1f} %, 95 % interval {100 * low:.1f} to {100 * high:.1f} %, counting 2",
        f"{summary['mean_time_s']:.2f} s",
        f"{summary['completion_time_s']['mean']:.1f} ± {summary['completion_time_s']['sd']:.1f} (SD) s",
        f"{summary['collisions_per_trial']:.2f}",
        f"{summary['complete_trials']} of {summary['trials']}",
    ):
        assert figure in page.text, figure


def test_it_has_a_heading_for_all_that_a_reader_looks_for(run):
    _, page, _ = run
    assert [text for level, text in page.headings if level == 2] == [
        "Beside the paper",
        "Failures",
        "Transfers",
        "Replay",
        "Pictures",
        "Time",
        "What was assumed",
        "How to run it again",
    ]


def test_the_paper_s_row_of_the_same_method_comes_first_and_ours_is_counted_its_way_too(run):
    _, page, summary = run
    ours, same = page.text.index("trocar, calibrated (play)"), page.text.index("as the paper counts")
    rows = [page.text.index(f"paper: {who}") for who in ("robot, calibrated ", "volunteers", "surgeon")]
    assert [ours, same, *rows] == sorted([ours, same, *rows])
    assert f"{summary['succeeded']} of {summary['available']}" in page.text[same : rows[0]]


def test_every_failure_is_named_and_those_of_any_trial_have_pictures_of_all_kinds_first(run):
    folder, page, _ = run
    shown = [image for image in page.images if image["title"].startswith("session_")]
    assert [image["title"] for image in shown] == [
        "session_01_trial_000_goal_02.png",
        "session_01_trial_000_goal_05.png",
    ]
    assert all((folder / "failed" / image["title"]).stat().st_size > 1000 for image in shown)
    assert "transfer 2 (peg" in shown[0]["alt"] and "dropped" in shown[0]["alt"]
    assert "not grasped 2" in page.text.replace("  ", " ") and "the block left the jaws before its target" in page.text
    assert "1 more failure without a picture here." in page.text


def test_each_goal_and_each_trial_has_a_row(run):
    _, page, _ = run
    assert "Each transfer, of 2 trials" in page.text and "2 peg 0 to 6 1 of 2" in page.text
    assert "1, 0 9 of 12 60.0 1" in page.text


def test_it_says_what_was_assumed_and_how_to_run_it_again(run):
    _, page, summary = run
    assert "Difficulty: mild. The laboratory's errors are smaller than in recordings" in page.text
    for what, how in summary["flaws"].items():
        assert all(part in page.text for part in what.split(": ", 1)) and how in page.text
    assert "trocar run peg-transfer --method calibrated --calibration joints --difficulty mild" in page.text
    assert "--sessions 2 --trials 1 --seed 3" in page.text
    for name, number in summary["versions"].items():
        assert f"{name} {number}" in page.text


def test_without_a_simulator_or_failures_the_page_is_still_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "can_photograph", lambda: False)
    monkeypatch.setattr(files, "find_spec", lambda module: None)
    trial = replace(synthetic_trial(RUN), spans=[])
    write_report(tmp_path, [trial], ["left aside: <b> is of another run"])
    page = assert_fit_to_show(tmp_path / "report.html")
    assert "every transfer that was attempted succeeded" in page.text and "left aside: <b> is of" in page.text
    assert not page.images and "Replay" not in [text for _, text in page.headings]


def test_pictures_that_cannot_be_drawn_again_are_kept_shown_and_told(tmp_path, monkeypatch):
    trial = synthetic_trial(RUN, failures={1: "DROPPED"})
    monkeypatch.setattr(files, "MOST_FAILED", 1)
    write_report(tmp_path, [trial])
    fuller = assert_fit_to_show(tmp_path / "report.html")
    drawn = {path: path.read_bytes() for path in [*tmp_path.rglob("*.png"), tmp_path / "replay.html"]}
    assert len(drawn) >= 3 and kept_pictures(tmp_path) == []

    monkeypatch.setattr(files, "can_photograph", lambda: False)
    monkeypatch.setattr(files, "find_spec", lambda module: None)
    (kept,) = kept_pictures(tmp_path)
    assert kept.startswith(
        "kept from an earlier report: storyboard.png, failed, replay.html; to draw them again, install"
    )
    write_report(tmp_path, [trial], [kept])
    page = assert_fit_to_show(tmp_path / "report.html")
    assert kept in page.text
    assert [image["title"] for image in page.images] == [image["title"] for image in fuller.images]
    assert all(path.read_bytes() == before for path, before in drawn.items() if path.name != "timechart.png")
    assert kept_pictures(tmp_path / "failed" / "none") == []


LINES = [
    *(f"run {name} --seed 4" for name in TASKS),
    "run peg-transfer --variant handover --transfers 3 --method optimized --model ridge --calibration joints "
    "--new-session --refit-offsets --flawless-camera --difficulty harsh --flaw offsets=2deg --flaw wear=0 "
    "--sessions 3 --trials 2",
    "run peg-transfer --method adaptive --planner sqp --budget 90",
    "run suture --count 3 --direction clockwise --calibration joints --prior fleet",
    "run debridement --arms 1 --fragments 4 --method paper --backdrop tissue --flaw kinematics=0.5",
]


@pytest.fixture
def config_of(monkeypatch):
    """Return what a line asks for, without running it."""

    def read(line):
        found = []

        def stop(config, folder):
            found.append(config)
            raise typer.Exit(0)

        monkeypatch.setattr(trials_folder, "open_folder", stop)
        result = CliRunner().invoke(app, shlex.split(line))
        assert result.exit_code == 0, result.exception
        return found[0]

    return read


@pytest.mark.parametrize("line", LINES)
def test_it_makes_the_same_run(config_of, line):
    asked = config_of(line)
    command = command_of(asked.about(), asked.sessions, asked.trials)
    assert command.startswith("trocar run ")
    again = config_of(command.removeprefix("trocar "))
    assert again.about() == asked.about()
    assert (again.sessions, again.trials) == (asked.sessions, asked.trials)


def test_files_that_were_given_are_named_as_such(config_of):
    about = config_of(LINES[0]).about() | {"plugins": ["3f2a"], "station": "mine", "prior": "mine.npz", "task": "own"}
    command = command_of(about, 1, 1)
    assert "--plugin FILE" in command and "--station FILE" in command and "--prior FILE" in command
