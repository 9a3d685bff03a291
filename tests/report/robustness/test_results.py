"""Figures and picture of a robustness study, from rows."""

import json
from dataclasses import asdict

import pytest
from PIL import Image

from synthetic import unmarked
from trocar.eval import TASKS
from trocar.eval.rows import row_file
from trocar.eval.trial import trial_file
from trocar.report.robustness.conditions import conditions_of
from trocar.report.robustness.report import write_study
from trocar.report.robustness.results import results_of
from trocar.report.robustness.row import VERSION, Row


@pytest.fixture
def conditions(tmp_path):
    """Three sessions at three sizes of one flaw; the largest costs half of the goals, and a trial is missing there."""
    task = TASKS.pick("peg-transfer")(transfers=4)
    found = conditions_of(
        tmp_path, task, methods="uncalibrated", flaws="outer", scales="0,1,4", difficulty="recorded", sessions=3
    )
    for condition in found:
        cell = condition.cell
        for session in range(3):
            if condition.scale == 4.0 and session == 2:
                continue
            reached = 4 if condition.scale < 4.0 else 1 + 2 * session
            row = Row(cell.config.fingerprint, session, 0, 4, reached, int(condition.scale), 20.0)
            path = row_file(trial_file(cell.folder, session, 0))
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps({"version": VERSION, **asdict(row)}))
    return found


def test_figures_count_goals_and_sessions(conditions, tmp_path):
    results, missing = results_of(conditions)
    none, recorded, large = (result.summary() for result in results)
    assert (recorded["succeeded"], recorded["goals"], recorded["success"]) == (12, 12, 1.0)
    assert (large["succeeded"], large["goals"], large["sessions"]) == (4, 8, 2)
    low, high = large["success_ci95"]
    assert low < 0.25 and high > 0.75, "two sessions say little"
    assert none["s_per_success"]["mean"] == pytest.approx(5.0) and large["s_per_success"]["mean"] == pytest.approx(10.0)
    assert large["collisions_per_trial"]["mean"] == 4.0
    assert len(missing) == 1 and "session_02" in missing[0]
    summary, files = write_study(tmp_path, "peg-transfer", results, missing)
    assert unmarked(files[0]) == summary
    assert missing[0] in summary["notes"]
    with Image.open(files[1]) as picture:
        assert min(picture.size) > 400
