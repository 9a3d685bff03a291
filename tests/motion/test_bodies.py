from itertools import product

import numpy as np

from trocar.arms import SOLIDS
from trocar.arms.solids import solid_radii_m
from trocar.motion import Capsule, MovingArm, rest_to_rest
from trocar.motion.bodies import Bodies, greatest_accelerations
from waypoints import FOUR, LEFT, PAPER, PSM, RIGHT

ONE = MovingArm(PSM, rest_to_rest(FOUR[0], FOUR[1], PAPER), LEFT)
TWO = MovingArm(PSM, rest_to_rest(FOUR[2], FOUR[3], PAPER), RIGHT, 0.1)
THINGS = {"ball": Capsule([0, 0, 0], radius_m=0.01), "rod": Capsule([0, 0, 0], [1, 0, 0], 0.02)}


def test_an_arm_meets_other_arms_and_obstacles_and_these_do_not_meet_each_other():
    bodies = Bodies.of({"one": ONE}, {"two": TWO}, THINGS)
    parts = [*(f"one {solid}" for solid in SOLIDS), *(f"two {solid}" for solid in SOLIDS), "ball", "rod"]
    assert list(bodies.names) == parts
    assert sorted(map(tuple, bodies.pairs.tolist())) == sorted(product(range(4), range(4, 10)))
    np.testing.assert_array_equal(bodies.radii_m, [*solid_radii_m(PSM), *solid_radii_m(PSM), 0.01, 0.02])
    both = Bodies.of({"one": ONE, "two": TWO}, {}, THINGS)
    wanted = [*product(range(4), range(4, 8)), *product(range(8), (8, 9))]
    assert sorted(map(tuple, both.pairs.tolist())) == sorted(wanted)
    assert Bodies.of({"one": ONE}, {}, {}).pairs.shape == (0, 2)


def test_where_they_are_and_how_much_they_accelerate():
    bodies = Bodies.of({"one": ONE}, {"two": TWO}, THINGS)
    times = np.array([0.0, 0.05, 0.3])
    ends = bodies.ends_m(times)
    np.testing.assert_array_equal(ends[:, :4], ONE.ends_m(times))
    np.testing.assert_array_equal(ends[:, 4:8], TWO.ends_m(times))
    np.testing.assert_array_equal(ends[:, 8:], np.tile([[[0, 0, 0]] * 2, [[0, 0, 0], [1, 0, 0]]], (3, 1, 1, 1)))
    found = bodies.accelerations(times[:-1], times[1:])
    np.testing.assert_array_equal(found[:, :4], greatest_accelerations(ONE, times[:-1], times[1:]))
    np.testing.assert_array_equal(found[:, 4:8], greatest_accelerations(TWO, times[:-1], times[1:]))
    assert found.shape == (2, 10) and not found[:, 8:].any()
