import numpy as np
import pytest

from trocar.arms import MOTION_LIMITS
from trocar.calibration.command_path import CommandRequest
from trocar.errors import TrocarError

PAPER = MOTION_LIMITS["paper"]
GOOD = {"q_start": np.zeros(6), "velocity_start": np.zeros(6), "lower": -np.ones(6), "upper": np.ones(6)}


def made(**changes):
    return CommandRequest(memory=None, desired=None, limits=PAPER, **(GOOD | changes))


@pytest.mark.parametrize("name", GOOD)
def test_a_request_holds_six_finite_numbers_each(name):
    assert made(**{name: [0.0] * 6}).__getattribute__(name).dtype == np.float64
    for wrong in (np.zeros(5), np.zeros((1, 6)), [0.0, 0.0, np.nan, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, np.inf]):
        with pytest.raises(TrocarError, match=f"{name} of a request .*give six finite numbers"):
            made(**{name: wrong})


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_commands_may_run_at_their_limit_and_no_faster(joint, sign):
    """A rounding above it is let through."""
    full = sign * PAPER.velocity * (np.arange(6) == joint)
    for share in (0.99, 1.0, 1.0 + 1e-7):
        assert made(velocity_start=share * full).velocity_start[joint] == share * full[joint]
    with pytest.raises(TrocarError, match=rf"joint {joint + 1} has commands that already run at 1\.01 times"):
        made(velocity_start=1.01 * full)
    with pytest.raises(TrocarError, match=rf"joint {joint + 1} "):
        made(velocity_start=(1.0 + 1e-5) * full)
