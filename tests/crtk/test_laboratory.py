"""What a station's table ``crtk.loop`` may say."""

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from trocar.crtk.laboratory import RAVEN_TICK_S, loop_settings
from trocar.errors import InvalidInput
from trocar.hardware.arm import LoopSettings
from trocar.lab.topics import Dialect, Topics


def test_whole_numbers_of_a_file_are_floats_and_are_taken():
    assert loop_settings(Topics(loop={"max_late": 20.0, "lag_s": 0.2})) == LoopSettings(max_late=20, lag_s=0.2)
    assert loop_settings(Topics(dialect=Dialect.RAVEN)).tick_s == RAVEN_TICK_S


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("max_late", 2.5, "max_late of a hardware loop is 2.5; give a whole number"),
        ("max_late", float("inf"), "max_late of a hardware loop is inf; give a whole number"),
        ("priority", 100.0, "priority of a hardware loop is 100; give a whole number, 0 to 99"),
        ("lag_s", float("inf"), "lag_s of a hardware loop is inf; give a finite number"),
        ("lagg_s", 0.1, "'lagg_s' is unknown; did you mean 'lag_s'"),
    ],
)
def test_what_is_out_of_bounds_is_refused(name, value, says):
    with pytest.raises(InvalidInput, match=says):
        loop_settings(Topics(loop={name: value}))
