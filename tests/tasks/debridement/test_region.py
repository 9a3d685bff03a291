"""Arms reach the region of the fragments, as far as can be known before a session."""

import numpy as np
import pytest

from trocar.arms import ik
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3
from trocar.lab import load_station
from trocar.lab.session import draw_session
from trocar.tasks.debridement.agents.places import TILT_RAD
from trocar.tasks.debridement.task import REGION_M

STATION = load_station("raven-pair")
SESSIONS = [draw_session(STATION, np.random.default_rng(seed)) for seed in range(24)]
ABOVE_M, AT_M = -0.120, -0.150
"""Heights of the tip in the world, above a fragment and at it."""
TURNED_RAD = np.radians([0.0, -15.0, 15.0, -30.0, 30.0, -40.0, 40.0])
INSIDE = 0.012
"""Of each joint's range, as of what the agent takes for within reach."""


def commanded(session, arm, T_world_tip):
    """The joints to be commanded so that the true ones bring the tip there."""
    model, cables, park = STATION.arms[arm].model, session.transmissions[arm], STATION.arms[arm].park_q()
    true = ik(model, session.T_world_base[arm].inverse() @ T_world_tip, reference=park)
    state, q = cables.start(park, np.random.default_rng(0)), true
    for _ in range(4):
        q = true - (cables.step(state, q)[0] - q)
        q = np.clip(q, model.lower, model.upper)
    return true - (cables.step(state, q)[0] - q)


def reaches(session, arm, x, y):
    model = STATION.arms[arm].model
    room = INSIDE * (model.upper - model.lower)
    for turn in TURNED_RAD:
        upright = SO3.axis("z", turn) @ SO3.axis("x", TILT_RAD)
        try:
            ways = [commanded(session, arm, SE3.from_parts(upright, [x, y, z])) for z in (AT_M, ABOVE_M)]
        except OutOfReach:
            continue
        if all(((model.lower + room < q) & (q < model.upper - room)).all() for q in ways):
            return True
    return False


@pytest.mark.parametrize(("arms", "sides"), [(1, ("left",)), (2, ("left", "right"))])
def test_a_working_arm_reaches_every_corner_in_nine_of_ten_sessions(arms, sides):
    (x0, y0), (x1, y1) = REGION_M[arms]
    for x in (x0, 0.5 * (x0 + x1), x1):
        for y in (y0, y1):
            share = np.mean([any(reaches(session, arm, x, y) for arm in sides) for session in SESSIONS])
            assert share >= 0.9, f"({1e3 * x:.0f}, {1e3 * y:.0f}) mm is reached in {share:.0%} of sessions"


def test_one_arm_does_not_reach_what_two_do():
    (x0, y0), _ = REGION_M[2]
    assert np.mean([reaches(session, "left", x0, y0) for session in SESSIONS]) < 0.9
