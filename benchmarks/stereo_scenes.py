"""Random scenes under the stereo pair of the station raven-pair, with the truth about them; for benchmarks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk, ik
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3, TURN
from trocar.lab import load_station
from trocar.perception.depth import project
from trocar.perception.image import Intrinsics, StereoImage, StereoRig
from trocar.sim.appearance import Appearance
from trocar.sim.cameras import STEREO_GAINS
from trocar.sim.laboratory import REST_S
from trocar.sim.ray_camera import RayCamera
from trocar.sim.sensor import Light
from trocar.sim.world import World
from trocar.tasks.debridement.goals import Workspace
from trocar.tasks.debridement.scene import GAP_M, lay_out
from trocar.tasks.debridement.world import DebridementWorld

STATION = load_station("raven-pair")
CAMERA = STATION.cameras["stereo"]
assert isinstance(CAMERA.model, StereoRig)
RIG = CAMERA.model
T_WORLD_TABLE = STATION.T_world_fixture["table"]
LAYOUTS = 10
"""Number of layouts for which one set of fragments and one place of the receptacle are used."""
TIPS_M = {
    "left": ((-0.080, -0.110, -0.152), (0.0, 0.03, -0.09)),
    "right": ((-0.150, -0.110, -0.152), (-0.070, 0.03, -0.09)),
}
TILT_RAD, OPEN_RAD = 0.4, 1.2


class Awake(DebridementWorld):
    """The work surface; bodies at rest stay awake, because they are moved directly."""

    sleeps = False


@dataclass(frozen=True, eq=False)
class Shown:
    """One pair of pictures, and the truth.

    Attributes:
        image: what the eyes deliver.
        ids: geom of each pixel in the left and the right picture.
        p_world_m: centre of volume of each fragment, by name.
        visible: share of each fragment's outline that is seen in the left and in the right eye, by name.
        T_world_tip: of each arm.
        jaw_rad: of each arm.
        marks: share of each of an arm's four marks that is seen in the left and the right eye (4, 2), by arm.
    """

    image: StereoImage
    ids: tuple[NDArray[np.int32], NDArray[np.int32]]
    p_world_m: dict[str, NDArray[np.float64]]
    visible: dict[str, tuple[float, float]]
    T_world_tip: dict[str, SE3]
    jaw_rad: dict[str, float]
    marks: dict[str, NDArray[np.float64]]


def scenes(count: int, seed: int, backdrop: str = "plain") -> Iterator[Shown]:
    """Yield random scenes: fragments anywhere in their region, arms anywhere over the surface, jaws open at random."""
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        if number % LAYOUTS == 0:
            fixtures = STATION.T_world_fixture
            scene = lay_out(fixtures["table"], fixtures["receptacle"], Workspace(), rng, backdrop)
            bases = {name: arm.T_world_base for name, arm in STATION.arms.items()}
            task = Awake(scene)
            world = World(STATION.models, bases, task)
            for name, arm in STATION.arms.items():
                set_arm(world, name, arm.park_q(), arm.park_jaw_rad)
            task.start(world)
            world.settle(REST_S)
            eyes = stereo_cameras(world)
            reach = [fragment.reach_m for fragment in scene.fragments]
        else:
            lay_anew(world, reach, rng)
        for name in world.arm_names:
            put_arm(world, name, rng)
        mujoco.mj_kinematics(world.model, world.data)
        yield show(world, eyes, rng)


def stereo_cameras(world: World, rig: StereoRig = RIG) -> tuple[RayCamera, RayCamera]:
    """Return both eyes over a world, as the simulated laboratory has them."""
    T, lamp = CAMERA.T_world_camera, np.array(CAMERA.lamp_m)
    light, finish = Light(CAMERA.ambient, CAMERA.gain), Appearance(world.model)
    lamp_right = rig.T_left_right.inverse().apply(lamp)
    left = RayCamera(world.model, rig.left, T, lamp, CAMERA.flaws, light, finish)
    return left, RayCamera(world.model, rig.right, T @ rig.T_left_right, lamp_right, CAMERA.flaws, light, finish)


def lay_anew(world: World, reach_m: list[float], rng: np.random.Generator) -> None:
    """Shift and turn all fragments at random over the region, without overlap."""
    region = np.array(Workspace().region_m)
    placed: list[tuple[NDArray[np.float64], float]] = []
    for name, reach in zip(world.free_bodies, reach_m, strict=True):
        T = world.free_pose(name)
        while True:
            place = rng.uniform(*region)
            if all(np.linalg.norm(place - other) > reach + far + GAP_M for other, far in placed):
                break
        placed.append((place, reach))
        turned = SO3.axis("z", rng.uniform(0, TURN)) @ T.rotation
        start = world.model.joint(name).qposadr[0]
        world.data.qpos[start : start + 7] = [*place, T.translation_m[2], *turned.as_quaternion()]


def put_arm(world: World, name: str, rng: np.random.Generator) -> None:
    """Put an arm's tip somewhere over its half of the surface, its tool at any roll and a little tilted."""
    arm, index = STATION.arms[name], world.arms[name]
    q = arm.park_q()
    for _ in range(300):
        turn = SO3.exp(rng.uniform(-TILT_RAD, TILT_RAD, 3)) @ SO3.axis("z", rng.uniform(0, TURN))
        T_world_tip = SE3.from_parts(turn, rng.uniform(*np.array(TIPS_M[name])))
        try:
            q = ik(arm.model, arm.T_world_base.inverse() @ T_world_tip)
            break
        except TrocarError:
            continue
    set_arm(world, name, q, float(rng.uniform(0, OPEN_RAD)))
    assert np.isfinite(world.data.qpos[index.qpos]).all()


def set_arm(world: World, name: str, q: NDArray[np.float64], jaw_rad: float) -> None:
    """Set an arm's joints and the opening of its jaws, and let its drives keep them there."""
    index = world.arms[name]
    world.data.qpos[index.qpos] = world.data.ctrl[index.drive] = q
    world.data.ctrl[index.jaw_drive] = jaw_rad / 2
    for finger, side in (("left", 1), ("right", -1)):
        world.data.qpos[world.model.joint(f"{name}_jaw_{finger}").qposadr[0]] = side * jaw_rad / 2


def show(world: World, eyes: tuple[RayCamera, RayCamera], rng: np.random.Generator) -> Shown:
    """Return the pair of pictures of a world as it stands, and the truth."""
    left, right = (eye.render_color(world.data, rng, gain) for eye, gain in zip(eyes, STEREO_GAINS, strict=True))
    ids = (eyes[0].render_exact(world.data)[1], eyes[1].render_exact(world.data)[1])
    visible, marks = {}, {}
    for name in world.free_bodies:
        geom, mesh = world.model.geom(name).id, world.model.mesh(name)
        first = mesh.vertadr[0]
        corners = world.model.mesh_vert[first : first + mesh.vertnum[0]]
        corners = corners @ world.data.geom_xmat[geom].reshape(3, 3).T + world.data.geom_xpos[geom]
        visible[name] = tuple(
            _share(eye.intrinsics, eye.T_world_camera, corners, id_, geom) for eye, id_ in zip(eyes, ids, strict=True)
        )
    for name, arm in STATION.models.items():
        shares = []
        for side in ("left", "right"):
            for k in (0, 1):
                geom = world.model.geom(f"{name}_mark_{side}{k}").id
                disc = np.pi * arm.instrument.marks.radius_m**2
                for eye, id_ in zip(eyes, ids, strict=True):
                    depth = eye.T_world_camera.inverse().apply(world.data.geom_xpos[geom])[2]
                    shares.append(np.count_nonzero(id_ == geom) * (depth / eye.intrinsics.fx) ** 2 / disc)
        marks[name] = np.array(shares).reshape(4, 2)
    return Shown(
        StereoImage(
            left, right, StereoRig(eyes[0].intrinsics, eyes[1].intrinsics, RIG.T_left_right), float(world.data.time)
        ),
        ids,
        {name: world.free_pose(name).translation_m for name in world.free_bodies},
        visible,
        {
            n: STATION.arms[n].T_world_base @ fk(a, world.data.qpos[world.arms[n].qpos])
            for n, a in STATION.models.items()
        },
        {n: 2 * float(world.data.qpos[world.arms[n].jaw_qpos]) for n in world.arm_names},
        marks,
    )


def _share(lens: Intrinsics, T_world_eye: SE3, corners_m: NDArray, ids: NDArray[np.int32], geom: int) -> float:
    """Return the visible share of a convex body's outline, including what lies outside the picture."""
    outline = project(lens, T_world_eye.inverse().apply(corners_m)).astype(np.float32)
    return float(np.count_nonzero(ids == geom) / cv2.contourArea(cv2.convexHull(outline)))
