"""Simulated laboratories for tests: cables without errors, and an arm that works by true poses."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
from numpy.typing import NDArray

from trocar.arms import MOTION_LIMITS, MotionLimits, fk, ik
from trocar.eval.scenery import Scenery
from trocar.eval.staged import encoded
from trocar.eval.trial import Trial
from trocar.geometry import SE3, SO3
from trocar.lab import TRANSMISSIONS, SensorFlaws, Station, load_station
from trocar.lab.flaws import Difficulty
from trocar.lab.session import Session
from trocar.lab.transmission import JawCable
from trocar.motion import rest_to_rest, straight
from trocar.perception.image import CameraModel, Intrinsics
from trocar.robots import TICK_S
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.record import fixed_poses, solids_of
from trocar.sim.spec import Surface
from trocar.sim.world import World
from trocar.tasks.peg_transfer.agents import Settings
from trocar.tasks.peg_transfer.grasps import Grasp, choose_grasp
from trocar.tasks.peg_transfer.scene import PegScene
from trocar.tasks.peg_transfer.shapes import Block, Pegboard
from trocar.tasks.peg_transfer.world import PegWorld

PAPER = MOTION_LIMITS["paper"]
TWICE = MotionLimits(2 * PAPER.velocity, 2 * PAPER.acceleration)
JAW_CLOSED_RAD = Settings().jaw_closed_rad


def mild(name: str) -> Station:
    """Return a station at the easy difficulty ``mild``, for tests of other things than errors."""
    return replace(load_station(name), difficulty=Difficulty.of("mild"))


def coarse(station: Station) -> Station:
    """Return a station whose cameras combine 2 x 2 pixels: faster, for tests that do not measure perception."""
    cameras = {name: replace(camera, model=_binned(camera.model)) for name, camera in station.cameras.items()}
    return replace(station, cameras=cameras)


def _binned(model: CameraModel) -> CameraModel:
    if isinstance(model, Intrinsics):
        return model.binned(2)
    return replace(model, left=model.left.binned(2), right=model.right.binned(2))


STATION = mild("peg-transfer")
ARM_MODELS = STATION.models
T_WORLD_BASE = {name: arm.T_world_base for name, arm in STATION.arms.items()}


def stiff(station: Station | str = STATION, limits: MotionLimits | None = None) -> Station:
    """Return a station whose joints follow their encoders; ``limits`` replaces those of its arms."""
    station = station if isinstance(station, Station) else mild(station)
    changes = {"limits": limits} if limits is not None else {}
    arms = {
        name: replace(arm, transmission=TRANSMISSIONS["stiff"], transmission_name="stiff", **changes)
        for name, arm in station.arms.items()
    }
    return replace(station, arms=arms)


def ideal_session(station: Station | str = STATION, limits: MotionLimits | None = None) -> Session:
    """Return a session in which joints follow their encoders and registration is exact."""
    station = stiff(station, limits)
    bases = {name: arm.T_world_base for name, arm in station.arms.items()}
    cameras = {name: camera.T_world_camera for name, camera in station.cameras.items()}
    transmissions = {name: arm.transmission for name, arm in station.arms.items()}
    jaws = {name: JawCable() for name in station.arms}
    return Session(station, station.models, transmissions, jaws, bases, bases, cameras, cameras)


def standing(peg: int, offset_m=(0.0, 0.0), yaw_rad: float = 0.0, height_m: float = 0.0) -> SE3:
    """Return ``T_board_block`` of an upright block round a peg, its lower face at ``height_m``."""
    place = Pegboard().pegs_m[peg] + [*offset_m, Block().height_m + height_m]
    return SE3.from_parts(SO3.axis("x", np.pi) @ SO3.axis("z", yaw_rad), place)


def scene_of(*T_board_blocks: SE3) -> PegScene:
    """Return a scene with the board at the world's origin and these blocks."""
    return PegScene(SE3.identity(), SE3(np.stack([T.matrix for T in T_board_blocks])))


def ideal_laboratory(
    *T_board_blocks: SE3, station: Station = STATION, limits: MotionLimits | None = None, **kwargs
) -> SimLaboratory:
    """Return an ideal session's two arms over a board with these blocks; the cameras have no flaws."""
    world = PegWorld(scene_of(*T_board_blocks))
    return SimLaboratory(
        ideal_session(station, limits), world, np.random.default_rng(0), flaws=SensorFlaws.none(), **kwargs
    )


def world_with_arms(*T_board_blocks: SE3, surface: Surface | None = None) -> World:
    """Return a world with both arms at zero and these blocks."""
    return World(ARM_MODELS, T_WORLD_BASE, PegWorld(scene_of(*T_board_blocks)), surface=surface or Surface())


def joints_at(arm: str, p_world_tip_m, yaw_rad: float = 0.0) -> NDArray[np.float64]:
    """Return the joints (6,) that put this arm's tip at a point of the world, the tool vertical."""
    T_world_tip = SE3.from_parts(SO3.axis("z", yaw_rad), p_world_tip_m)
    return ik(ARM_MODELS[arm], T_WORLD_BASE[arm].inverse() @ T_world_tip)


def blocks_of(world: World) -> SE3:
    """Return the true poses (k,) of the blocks in the world."""
    names = sorted(name for name in world.free_bodies if name.startswith("block"))
    return SE3(np.stack([world.free_pose(name).matrix for name in names]))


class Hand:
    """One arm of an ideal laboratory that grasps by true poses; its methods are steps of scripts."""

    def __init__(self, laboratory: SimLaboratory, arm: str = "psm1"):
        self.laboratory, self.arm, self.robot = laboratory, arm, laboratory.cell.robot
        self.model = laboratory.session.station.arm(arm).model
        self.T_base_world = laboratory.session.T_world_base[arm].inverse()

    @property
    def q(self) -> NDArray[np.float64]:
        """Return the arm's set-point (6,)."""
        return self.robot.setpoint(self.arm).q

    def T_tip_block(self, block: int) -> SE3:
        """Return the true pose of a block in the true tip."""
        world = self.laboratory.world
        T_world_tip = self.T_base_world.inverse() @ fk(self.model, world.joints(self.arm))
        return T_world_tip.inverse() @ blocks_of(world)[block]

    async def go(self, q: NDArray[np.float64], limits: MotionLimits = PAPER) -> None:
        """Move straight in joint space."""
        await self.robot.move({self.arm: rest_to_rest(self.q, q, limits)})

    async def shift(self, displacement_m, limits: MotionLimits = PAPER) -> None:
        """Move the tip straight, in the world's axes."""
        line = self.T_base_world.rotation.apply(np.array(displacement_m))
        await self.robot.move({self.arm: straight(self.model, self.q, line, limits)})

    async def grasp(self, block: int) -> Grasp:
        """Close the jaws round a wall of this block where it stands on its peg; the board is at the world's origin."""
        blocks = blocks_of(self.laboratory.world)
        grasp = choose_grasp(self.model, self.T_base_world, blocks[block], Pegboard(), Block(), blocks)
        assert isinstance(grasp, Grasp), grasp
        above = SE3.from_parts(translation_m=[0.0, 0.0, 0.03]) @ grasp.T_board_tip
        await self.robot.jaw(self.arm, grasp.jaw_rad)
        await self.go(ik(self.model, self.T_base_world @ above))
        await self.shift([0.0, 0.0, -0.03])
        await self.robot.jaw(self.arm, JAW_CLOSED_RAD)
        return grasp


def trial_of(laboratory: SimLaboratory, **about: object) -> Trial:
    """Return what happened in a laboratory, as a trial without scores."""
    record, station = laboratory.record(), laboratory.session.station
    images, cameras = encoded(laboratory.cameras)
    words = {"task": "none", "variant": "", "method": "by hand", "goal_noun": "goal", "planner": "", "model": None}
    choices = {"perception": "", "calibration": None, "prior": None, "options": {}} | {
        key: [] for key in ("set", "difficulty", "plugins")
    }
    switches = dict.fromkeys(("new_session", "refit_offsets", "flawless_camera"), False)
    rest = {"seed": 0, "session": 0, "index": 0, "fingerprint": "", "flaws": {}, "versions": {}}
    return Trial(
        about={
            **words,
            **rest,
            **choices,
            **switches,
            "station": station.name,
            "station_digest": "",
            "arms": list(station.arms),
            **about,
        },
        scores=[],
        spans=laboratory.log.spans,
        events=laboratory.log.events,
        collisions=[asdict(collision) for collision in record.collisions],
        ended="done",
        reason="",
        duration_s=round(laboratory.now_s(), 6),
        command_limit_use={arm: laboratory.driver.limit_use(arm) for arm in station.arms},
        arrays={
            **{name: rows.astype(np.float32) for name, rows in laboratory.recorder.arrays().items()},
            **laboratory.task.arrays(record),
        },
        scenery=Scenery(
            solids=solids_of(laboratory.world),
            T_world_body=fixed_poses(laboratory.world),
            arms=station.models,
            T_world_base=laboratory.session.T_world_base,
            T_world_base_registered=laboratory.session.T_world_base_registered,
            cameras=cameras,
            tick_s=TICK_S,
        ),
        images=images,
    )
