"""Every planner passes on every arm; one that breaks a promise is found out."""

import pytest

from trocar.arms import ARMS
from trocar.errors import NoPlan
from trocar.motion import PLANNERS, TimedPath, ignores
from trocar.testing import CheckFailed, check_planner
from waypoints import stops

PSM = [ARMS["psm-classic"]]


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)
def test_every_planner_passes_on_every_arm(planner, arm):
    assert check_planner(planner, [arm], problems=10) > 0


def test_a_function_can_be_checked_before_it_is_registered():
    assert check_planner(stops, PSM, problems=6) == 6


def test_a_planner_that_never_finds_anything_does_not_pass():
    @ignores()
    def never(problem):
        raise NoPlan("it is a test")

    with pytest.raises(CheckFailed, match="planner 'never' must: solve at least one of 3 problems of 'psm-classic'"):
        check_planner(never, PSM, problems=3)


def test_a_motion_that_is_too_fast_is_not_a_solution():
    """``plan_motion`` refuses it; so no problem is solved."""

    def hasty(problem):
        return {
            name: TimedPath(path.trajectory.stretched(0.9), 0.9 * path.waypoint_times_s)
            for name, path in stops(problem).items()
        }

    with pytest.raises(CheckFailed, match="solve at least one"):
        check_planner(hasty, PSM, problems=3)
