"""One laboratory as data: its arms, cameras, what is fixed on the table, and how well all that is registered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, MotionLimits, ik, wrist_depth_m
from trocar.calibration.excitation import MotionBox
from trocar.errors import TrocarError
from trocar.geometry import SE3, shown
from trocar.perception.image import CameraModel
from trocar.station.sensor_flaws import SensorFlaws
from trocar.station.transmission import Transmission

ABOVE_SAFE_DEPTH_M = 1e-3
"""An arm that rests in the middle of its ranges has its wrist this much deeper than the depth that is safe."""


@dataclass(frozen=True, eq=False)
class StationArm:
    """One arm of a laboratory.

    Attributes:
        model: robot type, with its instrument.
        transmission: what lies between its encoders and its joints.
        transmission_name: its name in ``TRANSMISSIONS``.
        limits: of velocity and acceleration that its guard keeps.
        T_world_base: where it was put.
        park: where it rests before a script: a tip (3,) m in the world with the tool along the base's z, joints (6,),
            or None: in the middle of its ranges, high in its port.
        park_jaw_rad: opening of its jaws there.
        workspace_m: (2, 3) corners in the world of the box that its tip may not leave; None: no box.
        calibration: where the motion of a calibration recording goes; None: the task says.
        T_world_base_registered: where a registration found the base; None: each session finds it anew.
    """

    model: ArmModel
    transmission: Transmission
    transmission_name: str
    limits: MotionLimits
    T_world_base: SE3
    park: NDArray[np.float64] | None = None
    park_jaw_rad: float = 0.1
    workspace_m: NDArray[np.float64] | None = None
    calibration: MotionBox | None = None
    T_world_base_registered: SE3 | None = None

    def park_q(self) -> NDArray[np.float64]:
        """Return the joints (6,) in which it rests before a script.

        Raises:
            TrocarError: the place lies out of its reach.
        """
        if self.park is None:
            q = self.model.middle.copy()
            short_m = self.model.safe_depth_m + ABOVE_SAFE_DEPTH_M - float(wrist_depth_m(self.model, q))
            q[2] += -self.model.wrist_sign * short_m
            return q
        if len(self.park) == len(self.model.joints):
            return self.park.copy()
        p_base_tip = self.T_world_base.inverse().apply(self.park)
        return ik(self.model, SE3.from_parts(translation_m=p_base_tip))


@dataclass(frozen=True, eq=False)
class StationCamera:
    """One camera of a laboratory.

    Attributes:
        model: lens of an RGBD camera, or the two of a stereo pair.
        T_world_camera: where it was put (of a pair: the left one).
        exposure_s: of one image.
        lamp_m: (3,) projector or lamp in the camera's frame.
        flaws: what the sensor does wrong.
        gain: of the exposure: what is near the lamp wants less.
    """

    model: CameraModel
    T_world_camera: SE3
    exposure_s: float
    lamp_m: tuple[float, float, float]
    flaws: SensorFlaws = field(default_factory=SensorFlaws)
    gain: float = 1.2


@dataclass(frozen=True)
class Registration:
    """How the arms' bases are found: a rigid fit to points that robot and camera both know.

    Attributes:
        points: how many.
        sd_m: noise of each on each axis.
        volume_m: corners of the box in the world in which they lie.
    """

    points: int = 270
    sd_m: float = 0.3e-3
    volume_m: tuple[tuple[float, float, float], tuple[float, float, float]] = ((-0.06, -0.04, 0.0), (0.06, 0.04, 0.05))


@dataclass(frozen=True, eq=False)
class Station:
    """A laboratory.

    Attributes:
        name: as ``--station`` takes it.
        about: one line.
        arms: by name, in order; the first works where one is enough.
        cameras: by name.
        T_world_fixture: nominal poses of what is fixed on the table, by name.
        registration: how the arms' bases are found.
        min_distance_m: that two arms' instruments keep; 0: not watched.
    """

    name: str
    about: str
    arms: Mapping[str, StationArm]
    cameras: Mapping[str, StationCamera]
    T_world_fixture: Mapping[str, SE3] = field(default_factory=dict)
    registration: Registration = field(default_factory=Registration)
    min_distance_m: float = 0.0

    def __post_init__(self) -> None:
        if not self.arms:
            raise TrocarError(f"station {self.name!r} has no arm; give one or more under [arms.NAME]")

    def arm(self, name: str) -> StationArm:
        """Return the arm of this name."""
        if name not in self.arms:
            raise TrocarError(f"station {self.name!r} has no arm {name!r}; it has {', '.join(self.arms)}")
        return self.arms[name]

    @property
    def models(self) -> dict[str, ArmModel]:
        """Return the arms' models by name."""
        return {name: arm.model for name, arm in self.arms.items()}

    def flaws(self, flawless_camera: bool = False) -> dict[str, str]:
        """Return in words what is imperfect here, for the summary of a run."""
        found = {f"transmission of {name}": arm.transmission.source for name, arm in self.arms.items()}
        how = self.registration
        found["registration of bases"] = f"{how.points} points, {shown(how.sd_m, 'm', 'g')} an axis"
        kept = [name for name, arm in self.arms.items() if arm.T_world_base_registered is not None]
        if kept:
            found[f"registration of {', '.join(kept)}"] = "as the station file has it"
        cameras = "switched off" if flawless_camera else "switched on, as large as the station's file says"
        return found | {f"flaws of camera {name}": cameras for name in self.cameras}
