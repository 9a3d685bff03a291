"""A planner of your own, complete: it comes to rest at every waypoint.

trocar plan transfer WAYPOINTS.npy --plugin examples/own_planner.py --planner stop-and-go
"""

from itertools import pairwise

from trocar.motion import PLANNERS, ArmMotion, Demand, MotionProblem, TimedPath, ignores, move_to, rest_to_rest


def from_stop_to_stop(arm: ArmMotion) -> TimedPath:
    """Return the plain moves of one arm, the first from a start that may be moving."""
    start, first, *more = arm.waypoints
    moves = [move_to(start, arm.start_velocity, first, arm.limits)]
    moves += [rest_to_rest(a, b, arm.limits) for a, b in pairwise([first, *more])]
    return TimedPath.joined(moves)


@ignores(Demand.STRAIGHT, Demand.DISTANCES, Demand.JERK)  # reported to the user if the check finds that it matters
def stop_and_go(problem: MotionProblem) -> dict[str, TimedPath]:
    """Return a path for every arm; it is checked for you."""
    return {name: from_stop_to_stop(arm) for name, arm in problem.arms.items()}


PLANNERS.register("stop-and-go", stop_and_go)
