"""What stays the same in a cell until somebody touches it: where the arms stand, and this day's cables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from trocar.arms import ARMS, ArmModel
from trocar.calibration.excitation import PSM1_BOX, PSM2_BOX, WAKE_RAD, MotionBox, random_smooth_path
from trocar.calibration.plant import PLANTS, CablePlant
from trocar.calibration.recording import Recording
from trocar.geometry import SE3, SO3
from trocar.geometry.rigid_fit import fit_rigid
from trocar.sim.transmission import UNREPEATABLE_SHARE, Transmission

ARM_NAMES = ("psm1", "psm2")
T_WORLD_BASE = {
    "psm1": SE3.from_parts(SO3.axis("z", np.pi), [0.1332, 0.0, 0.166]),
    "psm2": SE3.from_parts(SO3.axis("z", np.pi), [-0.1332, 0.0, 0.166]),
}
"""Nominal bases over the board, from the recorded poses (facts/peg_transfer.md): the pegs' middle at x = 134.2 +- 1 mm
in PSM1's base; grasps 162 mm below the remote centre, the jaws round the block over their whole length. One millimetre
closer, so that the insertion's 240 mm reach round the far blocks. PSM2 mirrors it."""

INSTRUMENTS = {"psm1": "psm1_grey", "psm2": "psm2_grey"}
"""Whose cables each arm has: the worn instruments of the paper's experiments."""

DRIFT_SD_RAD = (0.03, 0.04, 0.04)
"""SD of the change of the offsets of q4 q5 q6 from session to session (facts: up to .07 and .02-.1 rad)."""

REGISTRATION_POINTS = 270
REGISTRATION_SD_M = 0.3e-3
"""Points of the hand-eye registration and their noise an axis; the recorded sets have 270 and .33-.63 mm RMS."""

SAMPLE_S = 0.8
"""Time between two samples of a calibration recording (paper: 1355 in 18 minutes)."""


@dataclass(frozen=True, eq=False)
class Session:
    """The true state of a cell between two set-ups. Simulator truth, but for what calibration finds out.

    Attributes:
        arms: model of each arm.
        plants: this session's cables of each arm.
        T_world_base: true bases.
        T_world_base_found: bases as the registration found them.
    """

    arms: Mapping[str, ArmModel]
    plants: Mapping[str, CablePlant]
    T_world_base: Mapping[str, SE3]
    T_world_base_found: Mapping[str, SE3]

    def redrawn(self, rng: np.random.Generator) -> Session:
        """Return the same cell in its next session: the cables' offsets have changed."""
        plants = {name: _drifted(PLANTS[INSTRUMENTS[name]], rng) for name in self.plants}
        return replace(self, plants=plants)


def draw_session(rng: np.random.Generator, T_world_base: Mapping[str, SE3] | None = None) -> Session:
    """Return a cell with this session's offsets and a registration with its errors.

    Args:
        rng: of offsets and errors.
        T_world_base: which of the paper's two arms stand where; default: both at the pegboard.
    """
    T_world_base = T_WORLD_BASE if T_world_base is None else T_world_base
    arms = {name: ARMS["psm-classic"] for name in T_world_base}
    plants = {name: _drifted(PLANTS[INSTRUMENTS[name]], rng) for name in T_world_base}
    found = {name: _register(T, rng) for name, T in T_world_base.items()}
    return Session(arms, plants, T_world_base, found)


def record_motion(
    session: Session, arm: str, rng: np.random.Generator, samples: int | None = None, box: MotionBox | None = None
) -> Recording:
    """Return a calibration recording of this arm: the paper's random smooth motion, seen by noisy fiducials.

    The joints are those of the cell's cable transmission at rest after each step of .8 s; the servos' error at rest
    is below a thousandth of the cables' and left out (tested). Tracking the fiducials in images is not simulated:
    their noise is the recordings'. Before its first sample the wrist swings to and fro, which takes up the slack;
    those rows are commands without a measurement.

    Args:
        session: whose cables.
        arm: which arm.
        rng: of the motion and the noise.
        samples: only so many of the recording.
        box: where the motion goes; default: where the recorded arms went over a pegboard.
    """
    model = session.arms[arm]
    box = box or (PSM1_BOX if arm == "psm1" else PSM2_BOX)
    path = random_smooth_path(model, rng, box=box)[:samples]
    swing = np.append(np.zeros(3), WAKE_RAD)
    wake = np.clip([path[0] + swing, path[0] - swing], model.lower, model.upper)
    q_cmd = np.concatenate([wake, path])
    transmission = Transmission(session.plants[arm], q_cmd[0], rng)
    joints = []
    for q in q_cmd:
        transmission.advance(SAMPLE_S)
        joints.append(transmission.joints(q))
    noise = session.plants[arm].noise_sd * np.sqrt(1.0 - UNREPEATABLE_SHARE**2)
    measured = np.array(joints) + noise * rng.standard_normal(q_cmd.shape)
    return Recording(
        q_cmd=q_cmd,
        q_phy=measured,
        valid=np.arange(len(q_cmd)) >= len(wake),
        t_s=SAMPLE_S * np.arange(1.0, len(q_cmd) + 1.0),
        name=f"simulated recording of {arm}",
    )


def _drifted(plant: CablePlant, rng: np.random.Generator) -> CablePlant:
    return plant.with_offset(plant.offset + np.array(DRIFT_SD_RAD) * rng.standard_normal(3))


def _register(T_world_base: SE3, rng: np.random.Generator) -> SE3:
    """Return the base as a rigid fit to noisy points over the board finds it."""
    p_world = rng.uniform((-0.06, -0.04, 0.0), (0.06, 0.04, 0.05), (REGISTRATION_POINTS, 3))
    p_base = T_world_base.inverse().apply(p_world)
    seen = p_world + REGISTRATION_SD_M * rng.standard_normal(p_world.shape)
    return fit_rigid(p_base, seen).T_target_source
