"""Closings of jaws, found in the truth."""

from itertools import pairwise

import numpy as np
import pytest

from debridement_story import FIRST, HOME, OVER, TABLE_M, Story
from trocar.tasks.debridement.goals import FragmentOutcome
from trocar.tasks.debridement.grips import CLOSING_RAD, closings_of, legs, loss

RNG = np.random.default_rng(0)


def wave(*turns_rad):
    """Return jaws that go straight from one opening to the next."""
    return np.concatenate([np.linspace(a, b, 50) for a, b in pairwise(turns_rad)])


def test_each_closing_is_found_from_its_highest_to_its_lowest_point():
    jaw = wave(0.5, 1.2, 0.4, 0.4, 1.0, 0.0, 0.0)
    found = legs(jaw)
    assert [(round(jaw[a], 3), round(jaw[b], 3)) for a, b in found] == [(1.2, 0.4), (1.0, 0.0)]


def test_trembling_is_no_closing():
    jaw = wave(1.2, 0.4, 0.4, 1.2) + RNG.uniform(-0.4, 0.4, 150) * CLOSING_RAD
    assert len(legs(jaw)) == 1
    assert legs(0.5 + RNG.uniform(-0.4, 0.4, 500) * CLOSING_RAD) == []


def test_a_closing_in_steps_is_one():
    assert len(legs(wave(1.2, 1.0, 1.0, 0.8, 0.8, 0.5, 0.5, 0.0))) == 1


def test_closings_are_those_near_the_table_and_beside_the_receptacle():
    story = Story().jaws(0.3).jaws(1.2).above(FIRST).jaws(0.3, [0]).wait(0.3).lift().move(OVER).jaws(1.2)
    story.move([*OVER[:2], TABLE_M + 0.02]).jaws(0.2)
    (closing,) = closings_of(story.truth())
    assert closing.arm == "left" and closing.gripped == (0,)
    assert story.rows[closing.start][1] == pytest.approx(1.2) and story.rows[closing.opened][1] < 0.5
    assert story.rows[closing.closed][1] == pytest.approx(0.3, abs=0.03)


def test_a_closing_counts_where_jaws_stopped_though_they_began_higher_up_and_shut_in_the_air_in_the_end():
    story = Story().above(FIRST, 0.05).jaws(1.0, seconds=0.1).move([*FIRST[:2], TABLE_M + 0.012], speed_m_s=0.5)
    stopped_s = story.jaws(0.4, [0]).now_s
    story.wait(0.5).lift().lose(0, FIRST).jaws(0.0)
    (closing,) = closings_of(story.truth())
    assert closing.gripped == (0,)
    assert 0.01 * closing.closed == pytest.approx(stopped_s, abs=0.03)


@pytest.mark.parametrize(("of_three", "gripped"), [(2, (0,)), (1, ())])
def test_a_fragment_was_gripped_if_it_was_held_most_of_the_time_after_jaws_had_closed(of_three, gripped):
    """Contacts flicker."""
    story = Story().above(FIRST).jaws(0.4, [0])
    for tick in range(40):
        story.held = {0} if tick % 3 < of_three else set()
        story.wait(0.01)
    (closing,) = closings_of(story.truth())
    assert closing.gripped == gripped


@pytest.mark.parametrize(
    ("over_m", "to_m", "said", "what"),
    [
        (OVER, OVER - [0, 0, 0.045], True, None),
        (OVER, HOME, True, FragmentOutcome.DROPOFF_FAILURE),
        (HOME, HOME, True, FragmentOutcome.DROPOFF_FAILURE),
        (HOME, HOME, False, None),
    ],
    ids=["delivered", "beside", "announced elsewhere", "put back"],
)
def test_what_becomes_of_a_fragment_that_is_let_go(over_m, to_m, said, what):
    story = Story().grasp(0).lift().deliver(0, to_m=to_m, over_m=over_m)
    truth = story.truth()
    (closing,) = closings_of(truth)
    found, row = loss(truth, closing, 0, said)
    assert found is what
    assert abs(row - closing.opened) <= 10


def test_what_is_held_to_the_end_was_not_lost():
    truth = Story().grasp(0).lift().truth()
    (closing,) = closings_of(truth)
    assert loss(truth, closing, 0, False) == (None, len(truth.times_s) - 1)
