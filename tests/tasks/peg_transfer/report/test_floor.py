"""What motion alone would take."""

from types import SimpleNamespace

import pytest

from trocar.log import Span
from trocar.tasks.peg_transfer.report import floor_sentence, motion_floor_s


def made(spans, duration_s, transfers, arms=("a", "b")):
    return SimpleNamespace(spans=spans, duration_s=duration_s, about={"arms": arms}, scores=[{}] * transfers)


def test_the_floor_is_that_of_the_arm_that_moves_most_and_the_rest_adds_up():
    spans = [
        Span("a", "motion", 0.0, 4.0),
        Span("a", "capture", 3.5, 4.5),
        Span("a", "waiting", 4.5, 6.0),
        Span("b", "motion", 1.0, 3.0),
    ]
    seconds = motion_floor_s([made(spans, 8.0, 2)])
    assert seconds == pytest.approx({"motion": 2.0, "capture": 0.25, "waiting": 0.75, "other": 1.0})
    assert sum(seconds.values()) == pytest.approx(8.0 / 2)


def test_the_sentence_names_the_largest_part_first():
    said = floor_sentence({"motion": 2.0, "jaw": 0.3, "waiting": 0.7, "other": 0.001})
    assert "2.00 s per transfer" in said and said.endswith("the 1.00 s above that are waiting 0.70, jaw 0.30")


def test_trials_without_transfers_have_no_floor():
    assert motion_floor_s([made([], 1.0, 0)])["motion"] == 0.0
