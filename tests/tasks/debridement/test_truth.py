"""What the referee may read off the truth: which row a time is, and what is in the receptacle."""

import numpy as np
import pytest

from debridement_story import INSIDE, RECEPTACLE, Story
from trocar.tasks.debridement.goals import Receptacle
from trocar.tasks.debridement.truth import HEAP_M


@pytest.mark.parametrize(("time_s", "row"), [(-1.0, 0), (0.0, 0), (0.009, 0), (0.01, 1), (0.019, 1), (9.0, 10)])
def test_a_time_is_in_the_row_of_the_last_tick_before_it(time_s, row):
    truth = Story().wait(0.01).truth()
    assert len(truth.times_s) == 11 and truth.row(time_s) == row


@pytest.mark.parametrize(("off_m", "inside"), [(-1e-4, True), (1e-4, False)])
def test_a_heap_in_the_receptacle_may_stand_out_of_it_but_not_lie_beside_it(off_m, inside):
    middle, shape = RECEPTACLE.translation_m, Receptacle()
    beside = middle + [0.5 * shape.size_m[0] + off_m, 0.0, 0.005]
    across = middle - [0.0, 0.5 * shape.size_m[1] + off_m, -0.005]
    high = middle + [0.0, 0.0, shape.height_m + HEAP_M + off_m]
    truth = Story(INSIDE, beside, across, high).truth()
    assert truth.between_walls[-1].tolist() == [True, inside, inside, inside]
    assert truth.over_receptacle(np.stack([beside, across, high])).tolist() == [inside, inside, True]
    assert truth.over_receptacle(beside, margin_m=0.001)
