"""Requests of two Raven arms in one workspace, for tests of planners that keep distances."""

import numpy as np

from trocar.arms import capsules, ik
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3
from trocar.geometry.capsules import capsule_distances_m
from trocar.lab import load_station
from trocar.motion import ArmMotion, Facing, HalfSpace, MotionProblem
from trocar.motion.convex.scene import Scene

STATION = load_station("raven-pair")
NAMES = tuple(STATION.arms)
CAMERA_M = STATION.cameras["stereo"].T_world_camera.translation_m
TABLE = HalfSpace([0.0, 0.0, -0.162], [0.0, 0.0, 1.0])
KEPT_M = 1e-3


def down(tip_m, turn_rad=0.0, lean=(0.0, 0.0, 0.0)):
    """Return the pose of a gripper that points down, its jaws' axis along y unless turned."""
    return SE3.from_parts(SO3.exp(np.asarray(lean)) @ SO3.axis("z", turn_rad), tip_m)


def joints(name, T_world_tip):
    """Return the joints (6,) of an arm at a pose in the world."""
    arm = STATION.arms[name]
    return ik(arm.model, arm.T_world_base.inverse() @ T_world_tip)


def random_waypoints(rng, jaw_rad=1.2):
    """Return start and end (2 arms, 2, 6), at each of which the arms keep their distances."""
    ends = []
    while len(ends) < 2:
        lean = rng.uniform(-0.4, 0.4, 3) * [1, 1, 0]
        tips = rng.uniform([-0.15, -0.05, -0.15], [0.0, 0.05, -0.09], (2, 3))
        try:
            both = [
                joints(name, down(tip, rng.uniform(-0.4, 0.4), lean)) for name, tip in zip(NAMES, tips, strict=True)
            ]
        except OutOfReach:
            continue
        arms = [STATION.arms[name] for name in NAMES]
        solids = [capsules(a.model, q, jaw_rad).moved(a.T_world_base) for a, q in zip(arms, both, strict=True)]
        low = min((one.ends_m[..., 2].min(axis=-1) - one.radii_m).min() for one in solids)
        if low > -0.162 + 1.5 * KEPT_M and capsule_distances_m(*solids).min() > 1.5 * KEPT_M:
            ends.append(both)
    return np.stack(ends, axis=1)


def asked(waypoints, jaws=(0.5, 0.5), *, max_rad=None, max_tip_m_s=np.inf, obstacles=None, **more):
    """Return the problem of moving both arms through waypoints (2 arms, n, 6)."""
    facing = None if max_rad is None else Facing([0.0, 1.0, 0.0], CAMERA_M, max_rad)
    arms = {
        name: ArmMotion(
            STATION.arms[name].model,
            np.asarray(points),
            STATION.arms[name].limits,
            T_world_base=STATION.arms[name].T_world_base,
            jaw_rad=float(jaw),
            max_tip_m_s=max_tip_m_s,
            facing=facing,
        )
        for name, points, jaw in zip(NAMES, waypoints, jaws, strict=True)
    }
    obstacles = {"table": TABLE} if obstacles is None else obstacles
    return MotionProblem(arms, obstacles=obstacles, min_distance_m=KEPT_M, **more)


def swapping(y_m=0.0, depth_m=-0.13):
    """Return waypoints of tips that trade places: straight lines in joint space lead one arm through the other."""
    ends = [[-0.095, y_m, depth_m], [-0.055, -y_m, depth_m]]
    return np.array([[joints("left", down(p)) for p in ends], [joints("right", down(p)) for p in ends[::-1]]])


def least_m(problem, motions, seconds, count=1501):
    """Return the least distance along motions, given by arm, at ``count`` samples."""
    times = np.linspace(0.0, seconds, count)
    q = np.concatenate([motions[name](times) for name in problem.arms], axis=1)
    return Scene.of(problem).distances(q, times).distance_m.min()
