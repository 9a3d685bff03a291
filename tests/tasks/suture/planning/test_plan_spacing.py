import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.errors import TrocarError
from trocar.geometry import TURN
from trocar.tasks.suture.planning import Spacing

angles = st.floats(-10, 10)


@given(start=angles, length=st.floats(0.01, 6.2), theta=angles)
def test_forbidden_arcs_wrap(start, length, theta):
    into = (theta - start) % TURN
    if min(abs(into), abs(into - length), abs(into - TURN)) < 1e-6:
        return
    spacing = Spacing(1, 2, ((start, start + length),))
    assert spacing.allows([theta])[0] == (into > length)


def test_the_ends_of_arcs_are_allowed():
    assert Spacing(1, 2, ((6.0, 0.5),)).allows([6.0, 0.5, 6.1, 0.0, 0.4, 3.0]).tolist() == [1, 1, 0, 0, 0, 1]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((2, 1), "114.592 deg and 57.2958 deg; give a smallest gap"),
        ((0, 1), "above 0"),
        ((1, np.nan), "gaps between sutures"),
        ((1, 7), "at most 360"),
        ((1, 2, ((1, 1),)), "must differ"),
        ((1, 2, ((1, np.inf),)), "finite angles"),
        ((1, 2, ((1, 2, 3),)), "two angles"),
        ((1, 2, (), ("a",)), "finite angles"),
        ((1, 2, (), 3.0), "finite angles"),
        ((1, 2, (), (), -1), "tension weight is -1"),
    ],
)
def test_bad_spacings_are_refused(arguments, sentence):
    with pytest.raises(TrocarError, match=sentence):
        Spacing(*arguments)
