"""Calibration recordings of a simulated arm: its joints as noisy fiducials show them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk, ik
from trocar.calibration.excitation import WIDE_ROWS, MotionBox, random_smooth_path, slack_taken_up, wide_path
from trocar.calibration.recording import Recording
from trocar.lab.session import Session
from trocar.lab.transmission import DriveTrain

ROOM_RAD, ROOM_M = 0.5, 0.05
"""True joints may leave the commands' range by this much."""
SAMPLE_S = 0.8
"""Time between two samples of a calibration recording (paper: 1355 in 18 minutes)."""


def record_motion(
    session: Session,
    arm: str,
    rng: np.random.Generator,
    box: MotionBox,
    samples: int | None = None,
    *,
    wide: bool = False,
) -> Recording:
    """Return a calibration recording of this arm: the paper's random smooth motion, seen by noisy fiducials.

    The joints are those of the cell's drive train at rest after each step of .8 s; the servos' error at rest
    is below a thousandth of the cables' and left out (tested). Tracking the fiducials in images is not simulated; their
    noise is that of the recordings. Before its first sample the wrist swings back and forth, which takes up the slack;
    those rows are commands without a measurement.

    Args:
        session: with its transmissions.
        arm: which arm.
        rng: of the motion and the noise.
        box: range of the motion.
        samples: number of samples.
        wide: the motion is the short one of wide swings.
    """
    model = session.station.arm(arm).model
    path = wide_path(model, samples or WIDE_ROWS, box) if wide else random_smooth_path(model, rng, box=box)[:samples]
    q_cmd = slack_taken_up(model, path)
    train = DriveTrain(session.transmissions[arm], q_cmd[0], rng)
    joints = []
    for q in q_cmd:
        train.advance(SAMPLE_S)
        joints.append(train.joints(q))
    measured = _as_registered(session, arm, np.array(joints))
    measured = measured + session.transmissions[arm].measurement_sd * rng.standard_normal(q_cmd.shape)
    return Recording(
        q_cmd=q_cmd,
        q_phy=measured,
        valid=np.arange(len(q_cmd)) >= len(q_cmd) - len(path),
        t_s=SAMPLE_S * np.arange(1.0, len(q_cmd) + 1.0),
        name=f"simulated recording of {arm}",
    )


def _as_registered(session: Session, arm: str, joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return joints (n, 6) that would put the tip where it is, if the base were where registration found it.

    The measurement of the fiducials knows no other base, so errors of registration are in the recording and in its
    model.
    """
    model = session.station.arm(arm).model
    T_found_true = session.T_world_base_registered[arm].inverse() @ session.T_world_base[arm]
    return ik(model.widened(ROOM_RAD, ROOM_M), T_found_true @ fk(session.models[arm], joints), reference=joints)
