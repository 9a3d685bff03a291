"""The summary of a run agrees with its trials."""

import json
from dataclasses import replace

import pytest

from synthetic import PARTS_S, TRANSFER_S, config, synthetic_trial
from trocar.errors import TrocarError
from trocar.eval.statistics import session_interval
from trocar.log import Span
from trocar.report.files import report_of
from trocar.report.summary import summarise
from trocar.report.tables import parts_table, run_table

RUN = config(seed=3, trials=2)
KEYS = {
    *("task", "variant", "method", "seed", "trials", "sessions", "attempted", "succeeded", "success_rate"),
    *("success_ci95", "mean_time_s", "parts_s", "collisions_per_trial", "failures", "command_limit_use"),
    *("compute_ms", "missed_budgets", "machine_speed", "realtime_factor", "flaws", "versions"),
}
"""What DESIGN.md promises scripts."""


@pytest.fixture
def trials():
    return [
        synthetic_trial(RUN, 0, {2: "DROPPED", 5: "NOT_PLACED", 7: "NO_BLOCK"}),
        synthetic_trial(RUN, 1, {1: "DROPPED"}),
    ]


def test_every_promised_key_is_there_and_is_json(trials):
    summary = summarise(trials)
    assert set(summary) >= KEYS
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    said = [summary[key] for key in ("task", "variant", "method", "model", "seed")]
    assert said == ["peg-transfer", "unilateral", "calibrated", "play", 3]


def test_all_goals_are_counted_whatever_the_script_came_to(trials):
    summary = summarise(trials)
    assert (summary["trials"], summary["sessions"]) == (2, 1)
    assert summary["attempted"] == 24
    assert summary["succeeded"] == 20
    assert summary["success_rate"] == pytest.approx(20 / 24)
    assert summary["success_ci95"] == pytest.approx(session_interval([20], [24]))
    assert summary["failures"] == {"DROPPED": 2, "NOT_PLACED": 1, "NO_BLOCK": 1}
    assert summary["collisions_per_trial"] == 1.5
    assert summary["complete_trials"] == 0


def test_what_the_paper_counts_is_said_beside_it(trials):
    """There, a transfer was attempted only if its block stood on its source."""
    report = report_of(trials[0])
    summary = summarise(trials, report)
    counted = report.paper_count(summary)
    assert summary["available"] == 23 and (counted.succeeded, counted.attempted) == (20, 23)
    low, high = counted.ci95
    assert low < 20 / 23 < high and (low, high) != tuple(summary["success_ci95"])


def test_what_was_not_to_be_attempted_does_not_count():
    trial = synthetic_trial(RUN)
    scores = [*trial.scores[:-1], trial.scores[-1] | {"attempted": False, "succeeded": False}]
    summary = summarise([replace(trial, scores=scores)])
    assert (summary["succeeded"], summary["attempted"], summary["complete_trials"]) == (11, 11, 0)
    assert summary["success_ci95"] == pytest.approx(session_interval([11], [11]))


def test_the_interval_counts_sessions():
    runs = [synthetic_trial(RUN, index, {1: "DROPPED"}, session=session) for session in range(4) for index in range(2)]
    summary = summarise(runs)
    assert (summary["sessions"], summary["trials"]) == (4, 8)
    assert summary["success_ci95"] == pytest.approx(session_interval([22] * 4, [24] * 4))


def test_parts_add_up_to_the_mean_time():
    summary = summarise([synthetic_trial(RUN, 0), synthetic_trial(RUN, 1)])
    assert summary["mean_time_s"] == pytest.approx(TRANSFER_S)
    assert sum(summary["parts_s"].values()) == pytest.approx(summary["mean_time_s"])
    for name, seconds in PARTS_S.items():
        assert summary["parts_s"][name] == pytest.approx(seconds)
    assert summary["parts_s"]["other"] == pytest.approx(TRANSFER_S - sum(PARTS_S.values()))
    assert list(summary["parts_s"])[-1] == "other"
    assert summary["complete_trials"] == 2


def test_parts_of_two_arms_that_work_are_their_mean_and_a_part_that_no_table_knows_is_shown_too():
    trial = synthetic_trial(RUN)
    spans = [*trial.spans, Span("psm1", "singing", 4.5, 4.9)]
    summary = summarise([replace(trial, about=trial.about | {"arms": ["psm1", "psm2"]}, spans=spans)])
    assert summary["parts_s"]["motion"] == pytest.approx(PARTS_S["motion"] / 2)
    assert summary["parts_s"]["singing"] == pytest.approx(0.4 / 12 / 2)
    assert sum(summary["parts_s"].values()) == pytest.approx(summary["mean_time_s"])


@pytest.mark.parametrize(("speed", "missed"), [(0.5, 0.0), (0.52, 0.5), (1.0, 0.5), (3.2, 0.5), (3.3, 1.0)])
def test_computations_and_budgets_are_those_of_the_machine_for_which_these_were_declared(trials, speed, missed):
    """Perception took 30 ms of 98, planning 200 of 103: half as fast a machine says nothing against the planner."""
    summary = summarise([replace(trial, machine_speed=speed) for trial in trials])
    assert summary["compute_ms"] == {
        "perception": {"p50": pytest.approx(30.0 * speed), "p95": pytest.approx(30.0 * speed)},
        "planning": {"p50": pytest.approx(200.0 * speed), "p95": pytest.approx(200.0 * speed)},
    }
    assert summary["missed_budgets"] == pytest.approx(missed) and summary["machine_speed"] == pytest.approx(speed)
    assert summary["realtime_factor"] == pytest.approx(12 * TRANSFER_S / 10.0)


def test_without_computations_nothing_is_known_of_the_machine(trials):
    summary = summarise([replace(trial, computations=[]) for trial in trials])
    assert summary["machine_speed"] is None and summary["compute_ms"] == {} and summary["missed_budgets"] == 0.0


def test_the_largest_share_of_the_limits_is_that_of_any_arm_in_any_trial(trials):
    harder = replace(trials[1], command_limit_use={"psm1": (0.2, 0.3), "psm2": (0.7, 0.1)})
    assert summarise([trials[0], harder])["command_limit_use"] == {"velocity": 0.7, "acceleration": 0.99}


def test_no_success_and_no_goal_are_values_of_json():
    failed = summarise([synthetic_trial(RUN, 0, dict.fromkeys(range(12), "NO_BLOCK"))])
    assert failed["attempted"] == 12 and failed["success_rate"] == 0.0
    assert failed["success_ci95"][0] == 0.0 < failed["success_ci95"][1] < 0.9
    nothing = summarise([replace(synthetic_trial(RUN), scores=[])])
    assert nothing["attempted"] == 0
    assert nothing["success_rate"] is None and nothing["mean_time_s"] is None
    json.dumps(nothing, allow_nan=False)
    assert run_table(nothing) is not None and parts_table(nothing) is not None


def test_what_was_not_perfect_is_in_the_summary():
    flaws = summarise([synthetic_trial(RUN)])["flaws"]
    assert "psm1" in " ".join(flaws) and any("mm an axis" in how for how in flaws.values())
    off = summarise([synthetic_trial(config(method="uncalibrated", flawless_camera=True))])
    assert off["model"] is None
    assert off["flaws"]["flaws of camera overhead"] == "switched off" != flaws["flaws of camera overhead"]


def test_no_trials_are_said_so():
    with pytest.raises(TrocarError, match="no finished trials"):
        summarise([])
