import doctest
import pkgutil
from importlib import import_module
from itertools import pairwise

import pytest

from trocar import arms, motion
from trocar.arms import fk
from waypoints import FOUR, LEFT, PAPER, PSM, RIGHT, transfer

MODULES = [name for _, name, _ in pkgutil.iter_modules(motion.__path__)]


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_in_docstrings_run(name):
    known = {
        **{word: getattr(motion, word) for word in motion.__all__},
        **{word: getattr(arms, word) for word in ("ARMS", "MOTION_LIMITS")},
        "arm": PSM,
        "limits": PAPER,
        "waypoints": FOUR,
        "q_now": FOUR[0],
        "T_base_tips": fk(PSM, FOUR[1:]),
        "T_world_left": LEFT,
        "T_world_right": RIGHT,
        "left": transfer(LEFT, (-0.06, 0.0), (-0.03, 0.0)),
        "right": transfer(RIGHT, (0.06, 0.0), (0.03, 0.0)),
        "trajectory": motion.rest_to_rest(FOUR[0], FOUR[1], PAPER),
        "pairwise": pairwise,
    }
    module = import_module(f"trocar.motion.{name}")
    result = doctest.testmod(module, globs=vars(module) | known)
    assert result.failed == 0


def test_what_a_user_touches_first_has_an_example():
    for word in ("ArmMotion", "MotionProblem", "plan_motion", "plan_through", "rest_to_rest", "move_to"):
        assert ">>>" in getattr(motion, word).__doc__
