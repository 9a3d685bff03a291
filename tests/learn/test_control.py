import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trocar.arms import ARMS
from trocar.learn.control import slowed_together

LIMITS, PERIOD_S = ARMS["psm-classic"].motion_limits, 1 / 30
SPEED = st.floats(-5.0, 5.0)
"""Times the limit."""
JOINTS = st.lists(SPEED, min_size=6, max_size=6)


@given(JOINTS, JOINTS)
def test_all_joints_of_an_increment_are_slowed_by_one_factor(asked, now):
    asked = np.array(asked) * LIMITS.velocity
    velocity = np.clip(now, -1.0, 1.0) * LIMITS.velocity
    after = slowed_together(asked, velocity, LIMITS, PERIOD_S)
    most = LIMITS.acceleration * PERIOD_S
    assert (np.abs(after) <= LIMITS.velocity * (1 + 1e-9)).all()
    used = float((np.abs(after - velocity) / most).max())
    allowed = asked / max(1.0, float((np.abs(asked) / LIMITS.velocity).max()))
    left, done = allowed - after, after - velocity
    assert used <= 1 + 1e-9
    assert np.allclose(left, 0.0, atol=1e-9) or used > 1 - 1e-9, "as much as the limits allow"
    assert np.allclose(np.outer(left, done), np.outer(done, left), atol=1e-6) and left @ done >= -1e-9, "one factor"


def test_what_the_limits_allow_is_not_slowed():
    asked = 0.2 * LIMITS.acceleration * PERIOD_S
    assert np.allclose(slowed_together(asked, np.zeros(6), LIMITS, PERIOD_S), asked)
