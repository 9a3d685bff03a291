"""Sweeps: what their file says, their runs, figures and picture from rows, and a small one from end to end."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from numpy.testing import assert_allclose

from kept_figures import kept_figures
from synthetic import unmarked
from trocar.errors import TrocarError
from trocar.eval.study import read_study, row_file
from trocar.eval.trial import trial_file
from trocar.lab.flaws import FLAWS, Difficulty
from trocar.report.sweep import KIND, Row, Sweep, conditions_of, draw_curves, figures_of, tables_of, write_sweep

PEG = 'task = "peg-transfer"\n'


def read(tmp_path, text):
    path = tmp_path / "sweep.toml"
    path.write_text(text)
    return Sweep.read(path)


def test_the_laboratory_as_it_is_is_run_once_for_each_method_and_seed(tmp_path):
    text = PEG + 'methods = ["uncalibrated", "best"]\nseeds = [3, 4]\n[flaws]\nresidual = [1, 0]\nouter = [0, 1, 2]\n'
    points = read(tmp_path, text).points(tmp_path)
    sizes = [("residual", 0), ("residual", 1), ("outer", 0), ("outer", 1), ("outer", 2)]
    assert [(p.method, p.flaw, p.scale) for p in points[:5]] == [("uncalibrated", *size) for size in sizes]
    names = [one.folder.name for one in conditions_of(points)]
    assert len(points) == 10 and len(names) == 2 * 2 * 4
    assert names[:4] == [
        "uncalibrated-recorded-residual-0-seed-3",
        "uncalibrated-recorded-residual-0-seed-4",
        "uncalibrated-recorded-seed-3",
        "uncalibrated-recorded-seed-4",
    ]


@pytest.mark.parametrize("difficulty", ["mild", "recorded", "harsh"])
def test_one_flaw_is_varied_and_the_others_are_as_they_are(tmp_path, difficulty):
    usual = Difficulty.of(difficulty)
    text = f'methods = ["uncalibrated"]\ndifficulty = "{difficulty}"\n[flaws]\nresidual = [0, 1, 4]\nouter = [0, 4]\n'
    for point in read(tmp_path, PEG + text).points(tmp_path):
        sizes = point.conditions[0].config.laboratory.difficulty
        assert sizes.scale(point.flaw) == pytest.approx(point.scale, rel=1e-5)
        for other in set(FLAWS) - {point.flaw}:
            assert sizes.scale(other) == pytest.approx(usual.scale(other))


def test_sizes_have_the_unit_of_their_flaw(tmp_path):
    text = PEG + 'methods = ["best"]\n[flaws]\nregistration = [2]\nresidual = [2]\nwear = [2]\n'
    found = {p.flaw: p for p in read(tmp_path, text).points(tmp_path)}
    assert (found["registration"].size, found["registration"].unit) == (pytest.approx(0.4), "mm")
    assert (found["residual"].size, found["residual"].unit) == (pytest.approx(1.806, rel=1e-3), "deg")
    assert (found["wear"].size, found["wear"].unit) == (pytest.approx(2.0), "x")


def test_options_that_need_a_calibration_go_to_methods_that_have_one(tmp_path):
    text = PEG + 'methods = ["best", "uncalibrated"]\ncalibration = "joints"\n[options]\ntransfers = 2\n'
    best, uncalibrated = (p.conditions[0].config for p in read(tmp_path, text).points(tmp_path))
    assert (best.calibration, uncalibrated.calibration) == ("joints", "")
    assert best.task.transfers == 2


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("task =", "no readable TOML"),
        ("seeds = [1]", "names no task"),
        (PEG + "colour = 1", "key of '.*' 'colour' is unknown"),
        (PEG + 'methods = ["magic"]', "'magic'"),
        (PEG + "[flaws]\nwind = [1]", "flaw 'wind' is unknown"),
        (PEG + "[flaws]\nouter = [1, 1]", "give different numbers"),
        (PEG + '[flaws]\nouter = ["many"]', "give different numbers"),
        (PEG + "[flaws]\nouter = [-1]", "give different numbers"),
        (PEG + "[flaws]\nkinematics = [2]", "'kinematics'"),
        (PEG + "[options]\narms = 2", "option of peg-transfer 'arms' is unknown"),
        (PEG + 'difficulty = "easy"', "difficulty 'easy'"),
        (PEG + 'methods = "best"', "methods of '.*' is 'best'; it should be a valid array"),
        (PEG + "seeds = 3", "seeds of '.*' is 3; it should be a valid array"),
        (PEG + "seeds = []", r"seeds of '.*' is \[\]; .* at least 1 item"),
        (PEG + "seeds = [4, 4]", r"seeds of '.*' is \[4, 4\]; give each of them once"),
        (PEG + 'flaws = ["outer"]', r"write a table, \[flaws\]"),
        (PEG + 'options = "transfers"', r"write a table, \[options\]"),
        (PEG + 'sessions = "ten"', "sessions of '.*' is 'ten'; it should be a valid integer"),
        (PEG + "sessions = 1.5", "it should be a valid integer"),
        (PEG + 'new_session = "no"', "it should be a valid boolean"),
        (PEG + 'settings = "settle_s=1"', "it should be a valid array"),
        (PEG + '[options]\ntransfers = "two"', "transfers of '.*' is 'two'"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path, text, what):
    with pytest.raises(TrocarError, match=what):
        read(tmp_path, text).points(tmp_path)


def test_figures_count_goals_and_sessions_of_all_seeds(tmp_path, monkeypatch):
    """Three sessions of two seeds at three sizes; the largest costs half of the goals, and a trial is missing there."""
    text = PEG + 'methods = ["uncalibrated"]\nseeds = [0, 1]\nsessions = 3\n[flaws]\nouter = [0, 1, 4]\n'
    points = read(tmp_path, text).points(tmp_path)
    for point in points:
        for condition in point.conditions:
            for session in range(3):
                if point.scale == 4.0 and session == 2:
                    continue
                reached = 4 if point.scale < 4.0 else 1 + 2 * session
                row = Row(condition.config.fingerprint, session, 0, 4, reached, int(point.scale), 20.0)
                path = row_file(trial_file(condition.folder, session, 0))
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(json.dumps({"version": KIND.version, **asdict(row)}))
    results, missing = read_study(conditions_of(points), KIND)
    rows = {one.condition.folder: one.rows for one in results}
    none, recorded, large = (figures_of(point, rows) for point in points)
    assert (recorded["succeeded"], recorded["goals"], recorded["success"]) == (24, 24, 1.0)
    assert (large["succeeded"], large["goals"], large["sessions"], large["trials"]) == (8, 16, 4, 4)
    low, high = large["success_ci95"]
    assert low < 0.3 and high > 0.7, "four sessions say little"
    assert none["s_per_success"]["mean"] == pytest.approx(5.0) and large["s_per_success"]["mean"] == pytest.approx(10.0)
    assert large["collisions_per_trial"]["mean"] == 4.0
    twice = {folder: [*given, *given] for folder, given in rows.items()}
    assert figures_of(points[1], twice)["success_ci95"][1] == 1.0, "of all trials of a session"
    assert len(missing) == 2 and all("session_02" in sentence for sentence in missing)
    assert figures_of(points[0], {}) is None
    (table,) = tables_of([none, recorded, large])
    assert [row[2] for row in table.rows] == ["24 of 24", "24 of 24", "8 of 16"]
    assert table.rows[1][1].endswith("(recorded)") and not table.rows[2][1].endswith("(recorded)")
    pictures = kept_figures(monkeypatch)
    summary, files = write_sweep(tmp_path, "peg-transfer", [none, recorded, large], missing)
    success, collisions = pictures[0].axes
    curve, mark = success.lines
    sizes = [one["size"] for one in (none, recorded, large)]
    assert_allclose(curve.get_xydata(), np.column_stack([sizes, [100.0, 100.0, 50.0]]))
    draw_curves([large], tmp_path / "large.png")
    assert_allclose([mark.get_xdata(), pictures[1].axes[0].lines[1].get_xdata()], recorded["size"], rtol=1e-5)
    assert_allclose([bar[:, 1] for bar in success.collections[0].get_segments()][2], [100 * low, 100 * high])
    assert_allclose(collisions.lines[0].get_ydata(), [0.0, 1.0, 4.0])
    assert success.get_ylim()[0] == collisions.get_ylim()[0] == 0.0 and success.get_ylim()[1] > 100.0
    assert unmarked(files[0]) == summary and missing[0] in summary["notes"]
    assert files[1].name == "sweep.png" and files[1].is_file()


@pytest.mark.slow
def test_a_small_sweep_goes_on_where_it_stopped(trocar, tmp_path):
    text = 'methods = ["uncalibrated"]\nsessions = 1\nseeds = [2]\n[options]\ntransfers = 1\n[flaws]\noffsets = [0]\n'
    (tmp_path / "small.toml").write_text(PEG + text)
    line = ("sweep", tmp_path / "small.toml", "--jobs", 1, "--out", tmp_path / "sweep")
    code, out, error = trocar(*line, "--json")
    assert code == 0, error
    (row,) = json.loads(out)["conditions"]
    assert (row["flaw"], row["size"], row["unit"], row["goals"]) == ("offsets", 0.0, "deg", 1)
    trial = tmp_path / "sweep" / row["folders"][0] / "session_00" / "trial_000.npz"
    written = trial.stat().st_mtime_ns
    code, out, _ = trocar(*line)
    assert code == 0 and trial.stat().st_mtime_ns == written, "nothing is run again"
    assert "offsets" in out and (tmp_path / "sweep" / "sweep.png").stat().st_size > 5000
