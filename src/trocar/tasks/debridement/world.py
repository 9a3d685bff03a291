"""Work surface, receptacle and fragments in the simulator, and the referee, which tells agents nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from mujoco import mjtGeom
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from trocar.geometry import SE3, SO3
from trocar.sim.record import CollidingPair, Record
from trocar.sim.spec import INTANGIBLE, SOLID, digits, placed
from trocar.sim.world import TaskWorld, World
from trocar.tasks.debridement.goals import Clearing
from trocar.tasks.debridement.scene import GROUND, DebridementScene, Fragment
from trocar.tasks.debridement.truth import HEAP_M, DebridementTruth, Sights

RED_FOAM = (0.62, 0.05, 0.05)
WHITE_SURFACE = (0.75, 0.75, 0.74)
GREY_BOX = (0.30, 0.31, 0.33)
FINISHES = {
    "paper": (0.05, 0.0, 0.0),
    "plastic": (0.05, 0.0, 0.0),
    "wet foam": (0.12, 0.7, 0.5),
    "flesh": (0.10, 0.3, 0.4),
}
"""Grain, brightness and sharpness of wet spots (``trocar.sim.appearance``) by material (assumed)."""
FLOOR_M = 0.001  # thickness of the receptacle's floor

FOAM_N_M = 2500.0
"""Stiffness of foam under one finger (assumed): that of 65 mm^2 of foam rubber of 0.3 MPa, 8 mm thick. At the jaws'
force of 1.7 N, each finger sinks in by 0.7 mm."""
JAW_FRICTION = 1.5, 0.003, 0.0015
"""Friction of foam under a finger (assumed): sliding, including the hold of the teeth that sink in; torsional and
rolling friction in m, for the contact patch of 2 mm radius at 1 mm of indentation."""
FOAM_FRICTION = 0.9, 0.002, 0.0005  # the same for foam on foam (assumed)
DRY_FRICTION = 0.6, 0.002, 0.0001
"""The same for foam or steel on the work surface and the receptacle, which determine these contacts (assumed)."""
FOAM_WEIGHT = 1e6
"""Weight (``solmix``) with which foam, not steel, determines the softness of their contact. Of two frictions, MuJoCo
takes the larger one."""
FOAM_STRONGEST = 0.9995  # maximum impedance of a contact, which MuJoCo requires to stay below 1
CONTACT_S = 0.003  # time constant of foam's contacts: MuJoCo's steps of 1 ms are stable from .002 s on
CLING_REACH_M = 0.3e-3  # a charged fragment clings to a finger that it touched until it is this far away

DRY = {"priority": 2, "friction": DRY_FRICTION}

GRASP_PRESS_N = 2.0
"""Jaws that approach a fragment may touch the work surface with up to this force: an arm with a compliance of 1 mm/N is
then 2 mm too low, which is the planned distance of the fingers' ends from the surface. A larger force is a collision,
as is any other contact of an arm with the surface."""
GRASP_M = 0.030  # jaws approach a fragment if it is within this distance of their tip


class DebridementWorld(TaskWorld):
    """Fragments, receptacle and work surface. An arm that hits one of the last two counts as a collision."""

    sleeps = True

    def __init__(self, scene: DebridementScene):
        self._scene = scene
        self._touched: list[NDArray[np.bool_]] = []
        self._held: list[NDArray[np.bool_]] = []
        self._errands: dict[Clearing, int] = {}

    def add(self, spec: mujoco.MjSpec) -> None:
        """Add the work surface, the receptacle, and the fragments as free bodies."""
        for name, (grain, wet, sharp) in FINISHES.items():
            spec.add_material(name=name, roughness=grain, specular=wet, shininess=sharp)
        _add_table(spec, self._scene)
        _add_receptacle(spec, self._scene)
        _add_fragments(spec, self._scene)

    def start(self, world: World) -> None:
        """Look up the geoms of fragments, fingers, work surface and receptacle; give the fingers their friction."""
        fragments, self._world = self._scene.fragments, world
        self._fingers = Fingers(world, fragments)
        self._visibility = Visibility(world, self._scene)
        world.model.geom_friction[self._fingers.finger != NO_FINGER] = JAW_FRICTION
        self._table = world.model.geom("table").id
        self._walls = set(world.geoms("receptacle").tolist())

    def act(self) -> None:
        """Let charged fragments cling to fingers."""
        self._fingers.pull()

    def observe(self, time_s: float) -> None:
        """Record which fragments each arm touches and holds and, at intervals, which could be seen."""
        touched = self._fingers.touched()
        self._touched.append(np.any(touched, axis=1))
        self._held.append(self._fingers.held(touched))
        self._visibility.observe(time_s)

    def collision(self, first: int, second: int) -> CollidingPair | None:
        """Return the colliding pair if an arm touches the receptacle, or the work surface except lightly in a grasp."""
        for geom, other in ((first, second), (second, first)):
            arm = int(self._world.geom_arm[geom])
            if arm >= 0 and other in self._walls:
                return CollidingPair(self._world.arm_names[arm], "arm", "receptacle")
            if arm >= 0 and other == self._table and not self._brushes(geom, first, second):
                return CollidingPair(self._world.arm_names[arm], "arm", "table")
        return None

    def _brushes(self, geom: int, first: int, second: int) -> bool:
        """Return whether a finger touches the work surface lightly while it approaches a fragment."""
        if self._fingers.finger[geom] == NO_FINGER:
            return False
        data, force = self._world.data, np.zeros(6)
        for contact in np.flatnonzero((data.contact.geom[: data.ncon] == (first, second)).all(axis=1)):
            mujoco.mj_contactForce(self._world.model, data, int(contact), force)
            if force[0] > GRASP_PRESS_N:
                return False
        away = self._world.free_poses()[:, :2] - data.geom_xpos[geom][:2]
        return bool((np.linalg.norm(away, axis=-1) < GRASP_M).any())

    def errand(self, goal: Clearing) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the positions (world, m) of a fragment outside the receptacle, and of the receptacle.

        The fragment is the one that was nearest to the receptacle at the first call for this goal.
        """
        scene, fragments = self._scene, self._world.free_poses()[:, :3]
        middle = scene.T_world_receptacle.translation_m
        in_receptacle = scene.T_world_receptacle.inverse().apply(fragments)
        inside = scene.receptacle.holds(in_receptacle - [0.0, 0.0, HEAP_M])  # as the referee counts them
        away = np.where(inside, np.inf, np.linalg.norm(fragments - middle, axis=1))
        return fragments[self._errands.setdefault(goal, int(away.argmin()))], middle

    def truth(self, record: Record) -> DebridementTruth:
        """Return where fragments and tips were, and when fragments were held."""
        scene = self._scene
        poses = [record.T_world_body[f"fragment{k}"].matrix for k in range(len(scene.fragments))]
        return DebridementTruth(
            times_s=record.times_s,
            T_world_fragments=SE3.unchecked(np.stack(poses, axis=1)),
            held_by=self._by_arm(self._held),
            touched_by=self._by_arm(self._touched),
            jaw_rad={name: joints[:, 6] for name, joints in record.joints.items()},
            T_world_tips=record.T_world_tip,
            T_world_receptacle=scene.T_world_receptacle,
            receptacle=scene.receptacle,
            table_z_m=float(scene.T_world_table.translation_m[2]),
            sights=self._visibility.sights(),
        )

    def _by_arm(self, rows: list[NDArray[np.bool_]]) -> dict[str, NDArray[np.bool_]]:
        """Return (n, fragments) for each arm, from (arms, fragments) per tick."""
        return dict(zip(self._world.arm_names, np.moveaxis(np.array(rows), 1, 0), strict=True))

    def arrays(self, record: Record) -> Mapping[str, NDArray]:
        """Return the receptacle's true pose."""
        del record
        return {"T_world_receptacle": self._scene.T_world_receptacle.matrix}


NO_FINGER = -1
PRESSING = 0  # MuJoCo's ``contact.exclude`` for contacts with force; those within the gap are merely close


class Fingers:
    """Evaluates the contacts between fingers and fragments; fragment k is the geom and the body ``fragment{k}``."""

    def __init__(self, world: World, fragments: tuple[Fragment, ...]):
        model, self._world = world.model, world
        self._cling_n = np.array([fragment.cling_n for fragment in fragments])
        self._body = np.array([model.body(f"fragment{k}").id for k in range(len(fragments))])
        self.fragment = np.full(model.ngeom, -1)
        self.fragment[[model.geom(f"fragment{k}").id for k in range(len(fragments))]] = np.arange(len(fragments))
        self.finger = np.full(model.ngeom, NO_FINGER)
        for number, index in enumerate(world.arms.values()):
            for side, geom in enumerate(index.fingers):
                self.finger[model.geom_bodyid == model.geom_bodyid[geom]] = 2 * number + side
        self._clings = np.zeros((2 * len(world.arms), len(fragments)), dtype=bool)

    def touched(self) -> NDArray[np.bool_]:
        """Return which fragments touch which finger now, or cling to it: (arms, 2, fragments)."""
        fingers, fragments, solid, _ = self._meetings()
        found: NDArray[np.bool_] = self._clings.copy()
        found[fingers[solid], fragments[solid]] = True
        return found.reshape(-1, 2, found.shape[1])

    def held(self, touched: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which fragments are between the fingers of which arm (arms, fragments), given ``touched()``.

        These are fragments that both fingers touch, and two that touch each other and one finger each.
        """
        held: NDArray[np.bool_] = np.all(touched, axis=1)
        one = touched & ~held[:, None]
        if np.any(np.all(np.any(one, axis=2), axis=1)):
            data = self._world.data
            pairs = self.fragment[data.contact.geom[: data.ncon]]
            near = np.eye(held.shape[1], dtype=bool)
            for first, second in pairs[(pairs >= 0).all(axis=1)]:
                near[first, second] = near[second, first] = True
            held |= (one[:, 0] & (one[:, 1] @ near)) | (one[:, 1] & (one[:, 0] @ near))
        return held

    def pull(self) -> None:
        """Pull charged fragments towards each finger that they have touched, until they are out of its reach.

        The reaction on the finger, a thousandth of the force of its drive, is neglected.
        """
        if not self._cling_n.any():
            return
        data = self._world.data
        data.xfrc_applied[self._body] = 0.0
        fingers, fragments, solid, contacts = self._meetings()
        near = np.zeros_like(self._clings)
        near[fingers, fragments] = True
        self._clings &= near
        self._clings[fingers[solid], fragments[solid]] = True
        self._clings &= self._cling_n > 0
        # one pull for each finger and fragment, at the last of their contacts
        pulls = dict(zip(zip(fingers.tolist(), fragments.tolist(), strict=True), contacts.tolist(), strict=True))
        for (finger, fragment), contact in pulls.items():
            if not self._clings[finger, fragment]:
                continue
            body = self._body[fragment]
            out = data.contact.frame[contact][:3]  # from the first geom to the second
            towards = out if self.fragment[data.contact.geom[contact][0]] >= 0 else -out
            force = self._cling_n[fragment] * towards
            data.xfrc_applied[body, :3] += force
            data.xfrc_applied[body, 3:] += np.cross(data.contact.pos[contact] - data.xipos[body], force)

    def _meetings(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_], NDArray[np.intp]]:
        """Return finger, fragment, whether there is force, and number, for each contact of a finger with a fragment."""
        data = self._world.data
        pairs = data.contact.geom[: data.ncon]
        fingers, fragments = self.finger[pairs].max(axis=1, initial=-1), self.fragment[pairs].max(axis=1, initial=-1)
        contacts = np.flatnonzero((fingers >= 0) & (fragments >= 0))
        return fingers[contacts], fragments[contacts], data.contact.exclude[contacts] == PRESSING, contacts


LOOK_S = 0.5  # interval of the referee's checks; arms take seconds to pass over a fragment
POINTS = 8  # number of each fragment's corners that are checked
GROUPS = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)


class Visibility:
    """Checks at intervals which fragments could be seen, by rays from all eyes to points on them."""

    def __init__(self, world: World, scene: DebridementScene):
        self._world, self._eyes_m = world, scene.p_world_eyes_m
        corners_m = [fragment.vertices_m for fragment in scene.fragments]
        self._points_m = [corners[np.argsort(-corners[:, 2])[:POINTS]] for corners in corners_m]  # the topmost ones
        self._geom = [world.model.geom(f"fragment{k}").id for k in range(len(corners_m))]
        self._body = [world.model.body(f"fragment{k}").id for k in range(len(corners_m))]
        self._times: list[float] = []
        self._seen: list[list[float]] = []

    def observe(self, time_s: float) -> None:
        """Check, if it is time again."""
        if len(self._eyes_m) and (not self._times or time_s - self._times[-1] > LOOK_S - 1e-9):
            self._times.append(time_s)
            self._seen.append([self._share(k) for k in range(len(self._geom))])

    def sights(self) -> Sights:
        """Return all checks so far."""
        return Sights(np.array(self._times), np.array(self._seen).reshape(len(self._times), len(self._geom)))

    def _share(self, fragment: int) -> float:
        """Return the share of a fragment's points seen by the eye that sees least, since stereo needs both."""
        data, geom, body = self._world.data, self._geom[fragment], self._body[fragment]
        points = self._points_m[fragment] @ data.xmat[body].reshape(3, 3).T + data.xpos[body]
        middle = points.mean(axis=0)
        return min(self._seen_from(eye, middle + 0.8 * (points - middle), geom) for eye in self._eyes_m)

    def _seen_from(self, eye_m: NDArray[np.float64], points_m: NDArray[np.float64], geom: int) -> float:
        found, hit = 0, np.zeros(1, dtype=np.int32)
        for way in points_m - eye_m:
            mujoco.mj_ray(self._world.model, self._world.data, eye_m, way, GROUPS, 1, -1, hit, None)
            found += int(hit[0] == geom)
        return found / len(points_m)


def _add_table(spec: mujoco.MjSpec, scene: DebridementScene) -> None:
    """Add the work surface, and the patches of tissue on it if it has any."""
    rgb = GROUND if scene.tissue else WHITE_SURFACE
    plane = {"type": mjtGeom.mjGEOM_PLANE, "size": (0.5, 0.5, 0.01), "rgba": (*rgb, 1), "material": "paper"}
    spec.worldbody.add_geom(name="table", **plane, **DRY, **placed(scene.T_world_table), **SOLID)
    if not scene.tissue:
        return
    body = spec.worldbody.add_body(name="tissue")
    for number, patch in enumerate(scene.tissue):
        name = f"tissue{number}"
        spec.add_mesh(name=name, uservert=digits(patch.corners_m()).ravel())
        shape = {"type": mjtGeom.mjGEOM_MESH, "meshname": name, "rgba": (*patch.color, 1), "material": "flesh"}
        body.add_geom(name=name, **shape, **placed(patch.T_world_patch), **INTANGIBLE)


def _add_receptacle(spec: mujoco.MjSpec, scene: DebridementScene) -> None:
    body = spec.worldbody.add_body(name="receptacle", **placed(scene.T_world_receptacle))
    shape = scene.receptacle
    length, width = shape.size_m
    half, wall = 0.5 * shape.height_m, shape.wall_m
    sides = {
        "floor": ((length / 2 + wall, width / 2 + wall, FLOOR_M / 2), (0.0, 0.0, FLOOR_M / 2)),
        "left": ((wall / 2, width / 2 + wall, half), ((length + wall) / 2, 0.0, half)),
        "right": ((wall / 2, width / 2 + wall, half), (-(length + wall) / 2, 0.0, half)),
        "front": ((length / 2 + wall, wall / 2, half), (0.0, (width + wall) / 2, half)),
        "back": ((length / 2 + wall, wall / 2, half), (0.0, -(width + wall) / 2, half)),
    }
    look = {"type": mjtGeom.mjGEOM_BOX, "rgba": (*GREY_BOX, 1), "material": "plastic"}
    for name, (size, place) in sides.items():
        at = placed(SE3.from_parts(SO3.identity(), place))
        body.add_geom(name=f"receptacle_{name}", size=digits(size), **look, **DRY, **at, **SOLID)


def _add_fragments(spec: mujoco.MjSpec, scene: DebridementScene) -> None:
    for number, fragment in enumerate(scene.fragments):
        name = f"fragment{number}"
        spec.add_mesh(name=name, uservert=digits(fragment.vertices_m).ravel())
        body = spec.worldbody.add_body(name=name, **placed(fragment.T_world_fragment))
        body.add_freejoint(name=name)
        look = {"type": mjtGeom.mjGEOM_MESH, "meshname": name, "rgba": (*RED_FOAM, 1), "material": "wet foam"}
        body.add_geom(name=name, density=digits(fragment.density_kg_m3), **look, **_foam(fragment), **SOLID)


def _foam(fragment: Fragment) -> dict[str, Any]:
    """Return the attributes of a foam geom, equally soft under fingers and under other foam.

    The stiffness of MuJoCo's contacts is ``d / (1 - d) m / t^2``, with impedance d, time constant t and the mass m of
    the lighter body. Solving for d makes heavy and light pieces equally soft, and neither bursts out of the jaws.
    """
    mass = ConvexHull(fragment.vertices_m).volume * fragment.density_kg_m3
    ratio = FOAM_N_M * CONTACT_S**2 / mass
    impedance = min(ratio / (1.0 + ratio), FOAM_STRONGEST)
    reach = CLING_REACH_M if fragment.cling_n else 0.0
    return {
        "solmix": FOAM_WEIGHT,
        "condim": 6,
        "friction": FOAM_FRICTION,
        "solref": (CONTACT_S, 1.0),
        "solimp": digits((impedance, impedance, 1e-3, 0.5, 2.0)),
        "margin": reach,
        "gap": reach,
    }
