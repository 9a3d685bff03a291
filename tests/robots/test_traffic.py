"""How long a body waits for another one, beside a search by hand."""

from math import inf
from types import SimpleNamespace

import numpy as np
import pytest

from driven import ARM, PAPER
from simulated import STATION, joints_at
from trocar.arms import capsules, fk
from trocar.geometry.capsules import Capsules, capsule_distances_m
from trocar.motion import MovingArm, rest_to_rest
from trocar.robots import traffic
from trocar.robots.traffic import NEVER, Departure, MovingBody, Traffic, distance_m, min_delay_s

NOW_S, MARGIN_M = 7.0, 4e-3
DELAYS_S = np.arange(0.0, 2.0, 0.08).tolist()
THREAD = Capsules(np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.015]]]), np.array([1e-3]))


def body(name, from_m, to_m, start_s, held=None):
    motion = rest_to_rest(joints_at(name, (*from_m, 0.05)), joints_at(name, (*to_m, 0.05)), PAPER)
    return MovingBody(MovingArm(ARM, motion, STATION.arms[name].T_world_base, start_s, 0.2), held)


def apart_m(a, a_s, b, b_s, with_held=True):
    """Return the distance of two bodies at one time each, from their solids."""
    solids = []
    for one, at_s, whole in ((a, a_s, True), (b, b_s, with_held)):
        T = one.arm.T_world_base
        parts = [capsules(ARM, one.arm.joints(at_s), one.arm.jaw_rad).moved(T)]
        if one.held is not None and whole:
            parts.append(one.held.moved(T @ fk(ARM, one.arm.joints(at_s))))
        solids.append(parts)
    return min(capsule_distances_m(p, q).min() for p in solids[0] for q in solids[1])


def by_hand(mover, other, contact_s):
    """Return the first delay after which all samples are apart."""
    lasting_s = mover.arm.trajectory.duration_s
    for delay_s in DELAYS_S:
        last_s = max(lasting_s + delay_s, other.arm.end_s - NOW_S)
        least = inf
        for t in np.append(np.arange(0.0, last_s, 0.04), last_s):
            own_s = min(max(np.ceil((t - delay_s) / 0.04 - 1e-6) * 0.04, 0.0), lasting_s)
            touching = contact_s[0] <= t - delay_s < contact_s[1]
            least = min(least, apart_m(mover, own_s, other, NOW_S + t, with_held=not touching))
        if least >= MARGIN_M:
            return delay_s
    return None


@pytest.mark.parametrize("held", [None, THREAD])
@pytest.mark.parametrize("contact_s", [NEVER, (0.0, inf)])
@pytest.mark.parametrize(("leaves_to_m", "free"), [((-0.06, 0.0), True), ((-0.012, 0.0), False)])
def test_a_body_waits_as_long_as_the_other_one_is_in_its_way(held, contact_s, leaves_to_m, free):
    mover = body("psm1", (0.025, 0.0), (-0.005, 0.0), 0.0)
    other = body("psm2", (-0.01, 0.0), leaves_to_m, NOW_S + 0.4, held)
    found = min_delay_s(mover, other, NOW_S, MARGIN_M, DELAYS_S, contact_s)
    assert (found is not None) == free
    expected = by_hand(mover, other, contact_s)
    assert found == expected
    if free:
        assert found > 0.0
    assert distance_m(mover, 0.3, other, NOW_S + 0.2) == pytest.approx(apart_m(mover, 0.3, other, NOW_S + 0.2))
    empty = apart_m(mover, 0.3, other, NOW_S, with_held=False)
    assert distance_m(mover, 0.3, other.empty(), NOW_S) == pytest.approx(empty)


def beside(other, jaw_rad):
    """Return the traffic of two arms, of which the other is at the start of a motion, with its jaws open so far."""
    here = SimpleNamespace(moving=other.arm.trajectory.duration_s > 0.1, q=other.arm.joints(NOW_S), path_s=0.0)
    robot = SimpleNamespace(setpoint=lambda arm: here, read=lambda arm: SimpleNamespace(jaw_rad=jaw_rad))
    bases = {name: arm.T_world_base for name, arm in STATION.arms.items()}
    clock = SimpleNamespace(now_s=lambda: NOW_S)
    cell = SimpleNamespace(arms=STATION.models, T_world_base_registered=bases, robot=robot, clock=clock)
    return Traffic(cell, ("psm1", "psm2"), 2e-3)


def test_each_arm_departs_with_its_own_jaws_as_wide_open_as_they_are(monkeypatch):
    departing = []
    monkeypatch.setattr(traffic, "min_delay_s", lambda mover, *args: departing.append(mover.arm.jaw_rad) or 0.0)
    other, mover = body("psm2", (-0.06, 0.0), (-0.06, 0.0), NOW_S), body("psm1", (0.05, 0.0), (0.06, 0.0), NOW_S)
    both = beside(other, jaw_rad=0.7)
    both.lanes["psm1"].jaw_rad = 0.1
    leaves = Departure(other.arm.trajectory)
    both.lanes["psm2"].departure = leaves
    both.delay_s("psm1", mover.arm.trajectory, MARGIN_M, NEVER, leaves)
    assert departing[:2] == [0.1, 0.7]


@pytest.mark.parametrize(
    ("to_m", "goes_to_m", "delay_s"),
    [
        ((-0.01, 0.05), None, None),
        ((-0.01, 0.05), (-0.01, 0.0), traffic.DELAY_STEP_S),  # it has arrived, and will do something else
        ((-0.01, 0.05), (-0.07, 0.0), 0.0),  # it leaves before
        ((0.03, -0.05), None, 0.0),
    ],
)
def test_between_its_samples_a_motion_is_checked_too(monkeypatch, to_m, goes_to_m, delay_s):
    """Past the place of the other arm, which no sample is said to show; and away from it."""
    monkeypatch.setattr(traffic, "min_delay_s", lambda *args: 0.0)
    other = body("psm2", (-0.01, 0.0), goes_to_m or (-0.01, 0.0), NOW_S)
    both = beside(other, 0.2)
    both.lanes["psm2"].announced = other.arm.trajectory if goes_to_m else None
    mover = body("psm1", (-0.01, -0.05), to_m, NOW_S)
    for at_s, until_s in ((NOW_S, NOW_S), (mover.arm.end_s, other.arm.end_s)):
        assert distance_m(mover, at_s, other, until_s) > 2 * MARGIN_M
    assert both.delay_s("psm1", mover.arm.trajectory, MARGIN_M, NEVER, None) == delay_s
