"""Tables of a run, beside the paper."""

import io
from dataclasses import replace

from rich.console import Console

from synthetic import synthetic_trial
from trocar.report.tables import goals_table, parts_table, run_table
from trocar.tasks.peg_transfer.report import PAPER, PegReport

SUMMARY = {
    "task": "peg-transfer",
    "variant": "unilateral",
    "method": "calibrated",
    "model": "play",
    "goal_noun": "transfer",
    "trials": 2,
    "sessions": 1,
    "attempted": 12,
    "succeeded": 11,
    "success_rate": 11 / 12,
    "success_ci95": [0.646, 0.985],
    "mean_time_s": None,
    "parts_s": {"motion": 3.0, "jaw": 1.0},
}


def printed(*tables):
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(*tables)
    return console.export_text()


def test_tables_show_the_run_beside_the_paper():
    text = printed(run_table(SUMMARY, PAPER["unilateral"]), parts_table(SUMMARY))
    for words in ("11 of 12", "91.7 %", "64.6 % to 98.5 %", "34.7 %", "12.30", "75.0 %"):
        assert words in text
    assert "2 trials in 1 session, simulated" in " ".join(text.split()) and "trocar, calibrated (play)" in text
    assert text.index("paper: robot, calibrated") < text.index("paper: surgeon") and "120 of 120" in text
    text = printed(run_table(SUMMARY | {"method": "uncalibrated"}, PAPER["unilateral"][::-1]))
    assert text.rindex("paper: surgeon") > text.rindex("paper: robot, uncalibrated")


def test_a_run_without_a_paper_and_without_a_model_has_a_table_too():
    text = printed(run_table({**SUMMARY, "model": None, "success_rate": None, "attempted": 0, "succeeded": 0}))
    assert "paper" not in text and "trocar, calibrated " in text and "0 of 0" in text
    parts = printed(parts_table({**SUMMARY, "parts_s": {"motion": 3.0, "other": -2e-15}}))
    assert "-0.0" not in parts, "less than nothing by rounding is nothing"


def test_a_goal_in_which_trials_differ_is_not_named():
    first, second = synthetic_trial(), synthetic_trial(failures={2: "DROPPED"})
    other = replace(second, scores=[second.scores[1], *second.scores[1:]])
    number, which, done, _, *_, failures = goals_table([first, other], PegReport()).columns
    assert list(number.cells)[:3] == ["1", "2", "3"]
    assert [bool(cell) for cell in which.cells] == [False] + [True] * 11
    assert list(done.cells)[1:4] == ["2 of 2", "1 of 2", "2 of 2"] and list(failures.cells)[2] == "dropped 1"
