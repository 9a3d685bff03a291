"""Tables of a run, beside the paper."""

import io
from dataclasses import replace

from rich.console import Console

from synthetic import synthetic_trial
from trocar.report.tables import brief_flaws, failures_table, goals_table, parts_table, run_table, trials_table
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


def cells(table, row):
    return [list(column.cells)[row] for column in table.columns]


def test_the_goals_of_one_trial_say_how_each_ended_and_why():
    trial = synthetic_trial(failures={1: "DROPPED", 2: "NOT_PLACED"})
    scores = [
        *trial.scores[:2],
        trial.scores[2] | {"reason": "", "end_s": 19.0},
        trial.scores[3] | {"succeeded": False},
    ]
    table = goals_table([replace(trial, scores=scores)], PegReport())
    assert [column.header for column in table.columns] == ["transfer", "which", "result", "time s", "why"]
    assert cells(table, 0) == ["1", "peg 1 to 7", "done", "5.00", ""]
    assert cells(table, 1) == ["2", "peg 0 to 6", "dropped", "5.00", "made up: DROPPED"]
    sentence = "the block was released but does not stand on its target peg"
    assert cells(table, 2) == ["3", "peg 3 to 8", "not placed", "9.00", sentence]
    assert cells(table, 3)[2] == "not done"


def test_trials_of_different_length_show_all_goals():
    long, short = synthetic_trial(), synthetic_trial()
    table = goals_table([long, replace(short, scores=short.scores[:10])], PegReport())
    assert list(table.columns[2].cells) == ["2 of 2"] * 10 + ["1 of 1"] * 2


def test_each_trial_has_a_row_with_what_stopped_it():
    failed = replace(synthetic_trial(failures={1: "DROPPED", 4: "DROPPED", 5: "NO_BLOCK"}, session=2), ended="budget")
    table = trials_table([synthetic_trial(index=1), failed])
    assert cells(table, 0) == ["0, 1", "12 of 12", "60.0", "2", ""]
    assert cells(table, 1) == ["2, 0", "9 of 12", "60.0", "1", "dropped 2, no block 1; stopped: budget"]


def test_the_most_frequent_failure_comes_first_with_what_it_means():
    table = failures_table({"NOT_PLACED": 1, "DROPPED": 3, "FELL": 1}, 24, "transfer", PegReport())
    assert [column.header for column in table.columns] == ["failure", "of 24 transfers", "what it means"]
    assert cells(table, 0) == ["dropped", "3", "the block left the jaws before its target"]
    assert cells(table, 1) == ["fell", "1", ""] and cells(table, 2)[0] == "not placed"


def test_flaws_are_named_in_brief_where_they_differ():
    flaws = {"difficulty": "recorded, jaw=1deg, wear=2", "camera": "switched off", "psm1": "as recorded"}
    said = "laboratory: difficulty recorded except for jaw=1deg, wear=2; camera switched off; summary.json has"
    assert brief_flaws(flaws).startswith(said)
    fitted = brief_flaws({"difficulty": "mild", "cable models are fitted on": "joints"})
    assert fitted.startswith("laboratory: difficulty mild; cable models are fitted on joints; ")
