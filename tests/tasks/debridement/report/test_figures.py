"""A trial in numbers."""

from dataclasses import replace

import pytest

from made_up_debridement import made_up, score
from trocar.eval.config import RunConfig
from trocar.log import Span
from trocar.tasks.debridement.report.figures import row_of
from trocar.tasks.debridement.task import Debridement


def test_time_by_part_is_the_mean_of_the_working_arms_and_adds_up():
    row = row_of(made_up())  # two arms, three fragments each
    assert row.duration_s == 30.0
    assert row.parts_s == pytest.approx({"perception": 4.5, "planning": 6.0, "motion": 16.5, "waiting": 3.0})
    assert sum(row.parts_s.values()) == pytest.approx(row.duration_s)


def test_one_arm_is_not_averaged_with_the_one_that_is_parked():
    row = row_of(made_up(RunConfig(Debridement(arms=1), seed=2)))
    assert row.duration_s == 60.0
    assert row.parts_s == pytest.approx({"perception": 9.0, "planning": 12.0, "motion": 33.0, "waiting": 6.0})


def test_spans_that_overlap_are_counted_once():
    trial = made_up()
    more = [Span(arm, "capture", 4.0, 6.0) for arm in trial.about["arms"]]  # while the arm moves
    assert row_of(replace(trial, spans=[*trial.spans, *more])).parts_s == pytest.approx(row_of(trial).parts_s)


def test_plans_of_all_arms_are_counted():
    assert row_of(made_up()).plans == 6


def test_failures_are_counted_of_fragments_or_of_attempts():
    scores = [
        score(0, 0.0, attempts=3, grasp_failures=2, fragment_false_negatives=4),
        score(1, 0.0, failure="DROPPED_EN_ROUTE", attempts=1, drops_en_route=1),
        score(2, 10.0, failure="NOT_CLEARED", attempts=0),
    ]
    row = row_of(made_up(scores=scores))
    assert row.modes["grasp_failures"] == [2, 4]
    assert row.modes["drops_en_route"] == [1, 4]
    assert row.modes["fragment_false_negatives"] == [1, 3]  # a fragment counts once, however often it was overlooked
    assert (row.fragments, row.cleared, row.first_attempts, row.attempts, row.recoveries) == (3, 1, 0, 4, 2)
    assert row.failures == {"DROPPED_EN_ROUTE": 1, "NOT_CLEARED": 1}


def test_a_trial_without_fragments_has_a_row():
    row = row_of(made_up(scores=[]))
    assert row.fragments == 0 and set(map(tuple, row.modes.values())) == {(0, 0)}
