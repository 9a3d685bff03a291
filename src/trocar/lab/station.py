"""One laboratory as data: its arms, its cameras, what is fixed on the table, and how all of it is registered."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace

from trocar.arms import ArmModel, MotionLimits, ik, wrist_depth_m
from trocar.calibration.excitation import MotionBox
from trocar.checks import require_numbers
from trocar.errors import InvalidInput, UnknownName
from trocar.geometry import SE3, SO3, shown
from trocar.geometry.arrays import Array
from trocar.lab.flaws import DEFAULT, FLAWS, Difficulty
from trocar.lab.topics import Topics
from trocar.lab.transmission import Transmission
from trocar.notebook import table
from trocar.perception.checkerboard import Checkerboard
from trocar.perception.image import CameraModel, Intrinsics, StereoRig

ABOVE_SAFE_DEPTH_M = 1e-3
"""The wrist of an arm that parks in the middle of its ranges is this much deeper than the safe depth."""


@dataclass(frozen=True)
class Registration:
    """A rigid fit of each base to points that robot and camera both know; the cameras are the world's reference.

    Attributes:
        points: number of points.
        sd_m: SD of a point's noise on each axis.
        volume_m: corners, in the world, of the box in which the points lie.
    """

    points: int = 270
    sd_m: float = 0.3e-3
    volume_m: tuple[tuple[float, float, float], tuple[float, float, float]] = ((-0.06, -0.04, 0.0), (0.06, 0.04, 0.05))

    def __post_init__(self) -> None:
        require_numbers(self)

    @property
    def about(self) -> str:
        """Return a description with the accuracy."""
        return f"{self.points} points, {shown(self.sd_m, 'm', 'g')} an axis"


@dataclass(frozen=True, eq=False)
class CheckerboardRegistration:
    """A checkerboard on a bracket on each base in turn; the first arm's base is the world's reference.

    The camera's pose follows from the first arm's board, the other bases from theirs (Kehoe et al. 2014, IV-B).

    Attributes:
        board: the board that brackets and people hold.
        T_world_board: nominal pose of the board on each arm's bracket.
        sd_m: SD of a registered base's position at the board, on each axis; bracket and images together.
        sd_rad: SD of its rotation about each axis.
        bracket_sd_m: SD of the board's position on a bracket, on each axis.
        bracket_sd_rad: SD of the board's rotation on a bracket, about each axis.
        views: number of poses in which a person shows the board to calibrate the lenses.
    """

    board: Checkerboard = field(default_factory=Checkerboard)
    T_world_board: SE3 = field(default_factory=lambda: SE3.from_parts(SO3.axis("y", math.pi)))
    sd_m: float = 0.3e-3
    sd_rad: float = math.radians(0.1)
    bracket_sd_m: float = 0.3e-3
    bracket_sd_rad: float = math.radians(0.1)
    views: int = 20

    def __post_init__(self) -> None:
        require_numbers(self)

    @property
    def about(self) -> str:
        """Return a description with the accuracy."""
        return f"checkerboard, {shown(self.sd_m, 'm', 'g')} an axis and {shown(self.sd_rad, 'rad', 'g')} about each"


@dataclass(frozen=True)
class SensorFlaws:
    """Magnitudes of a depth camera's flaws; zero switches one off.

    Sizes follow the authors' Zivid One+ S. Its distances between spheres are off by .32 mm RMS
    (`fiducials/sphere_distances`). Its capture of a block, on which printed layers show, is off the block's model by
    .38 mm in the median and .76 mm RMS (`blocks/capture`).

    Attributes:
        axial_m: SD of white depth noise at ``reference_m``, seen face on; grows with depth squared and 1/cos.
        waviness_m: SD of smooth depth noise, as projected fringes cause it.
        waviness_px: correlation length of the smooth noise.
        reference_m: distance at which ``axial_m`` holds.
        grazing_cos: below this cosine of incidence, pixels go missing ever more often.
        missing: share of pixels that go missing anywhere.
        shadow: whether pixels that the projector does not light have no depth and little colour.
        edge_missing: share of pixels beside a jump of depth that go missing.
        edge_mixed: share of pixels beside a jump of depth that get a depth between the two surfaces.
        specular_missing: share of pixels lost where bare metal mirrors the projector into the lens.
        color_sd: SD of colour noise in grey levels of 255, the same in all three channels.
    """

    axial_m: float = 0.15e-3
    waviness_m: float = 0.10e-3
    waviness_px: float = 6.0
    reference_m: float = 0.6
    grazing_cos: float = 0.22
    missing: float = 0.005
    shadow: bool = True
    edge_missing: float = 0.35
    edge_mixed: float = 0.25
    specular_missing: float = 0.9
    color_sd: float = 2.5

    def __post_init__(self) -> None:
        require_numbers(self)

    def with_depth(self, scale: float) -> SensorFlaws:
        """Return the flaws with this factor on the noise of depth."""
        return replace(self, axial_m=scale * self.axial_m, waviness_m=scale * self.waviness_m)

    @staticmethod
    def none() -> SensorFlaws:
        """Return a perfect sensor: exact depth everywhere, noiseless colour, light without shadow."""
        sizes = (field for field in fields(SensorFlaws) if field.name not in ("waviness_px", "reference_m"))
        return SensorFlaws(**{field.name: type(field.default)(0) for field in sizes})  # type: ignore[call-arg]


@dataclass(frozen=True, eq=False)
class StationArm:
    """One arm of a laboratory.

    Attributes:
        model: robot type, with its instrument.
        transmission: what lies between its encoders and its joints.
        transmission_name: name of the transmission in ``TRANSMISSIONS``.
        limits: velocity and acceleration limits that its guard keeps.
        T_world_base: true pose of the base.
        park: where it rests before a script: a tip (3,) m in the world, with the tool aligned with the base, or joints
            (6,), or None: the middle of its ranges, high in its port.
        park_jaw_rad: opening of its jaws there.
        workspace_m: (2, 3) corners, in the world, of the box that its tip may not leave; None: no box.
        calibration: range of the motion of a calibration recording; None: defined by the task.
        T_world_base_registered: registered pose of the base; None: each session registers it.
    """

    model: ArmModel
    transmission: Transmission
    transmission_name: str
    limits: MotionLimits
    T_world_base: SE3
    park: Array | None = None
    park_jaw_rad: float = 0.1
    workspace_m: Array | None = None
    calibration: MotionBox | None = None
    T_world_base_registered: SE3 | None = None

    def __post_init__(self) -> None:
        require_numbers(self)

    def __repr__(self) -> str:
        return f"<StationArm {self.model.name}, transmission {self.transmission_name!r}, base at {self.T_world_base!r}>"

    @property
    def speeds(self) -> str:
        """Return the greatest velocity of each joint as text."""
        each = zip(self.model.joints, self.limits.velocity, strict=True)
        return ", ".join(f"{joint.name} {speed:.3g} {joint.unit}/s" for joint, speed in each)

    def park_q(self) -> Array:
        """Return the joints (6,) in which it rests before a script.

        Raises:
            OutOfReach: the tip cannot reach ``park``.
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
        model: lens of an RGBD camera, or the two lenses of a stereo pair.
        T_world_camera: true pose (of a pair: of the left camera).
        exposure_s: exposure of one image.
        lamp_m: (3,) position of the projector or lamp in the camera's frame.
        flaws: the sensor's flaws.
        gain: exposure gain; objects near the lamp need less.
        ambient: room light from all directions, as a share of the lamp's at .6 m.
        T_world_camera_registered: registered pose; None: each session registers it.
        rig_registered: calibrated lenses of a pair; None: ``model``.
    """

    model: CameraModel
    T_world_camera: SE3
    exposure_s: float
    lamp_m: tuple[float, float, float]
    flaws: SensorFlaws = field(default_factory=SensorFlaws)
    gain: float = 1.2
    ambient: float = 0.06
    T_world_camera_registered: SE3 | None = None
    rig_registered: StereoRig | None = None

    def __post_init__(self) -> None:
        require_numbers(self)

    def __repr__(self) -> str:
        kind = "stereo pair" if isinstance(self.model, StereoRig) else "RGBD camera"
        return f"<StationCamera: {kind}, at {self.T_world_camera!r}>"

    @property
    def model_registered(self) -> CameraModel:
        """Return the lens or lenses that the user of the camera knows."""
        return self.rig_registered or self.model


@dataclass(frozen=True, eq=False)
class Station:
    """A laboratory.

    Attributes:
        name: name for ``--station``.
        about: description in one line.
        arms: arms by name, in order; the first one works where one is enough.
        cameras: cameras by name.
        T_world_fixture: nominal poses of what is fixed on the table, by name.
        registration: how the arms' bases are registered.
        min_distance_m: distance to keep between the instruments of two arms; 0: not checked.
        difficulty: how far the true laboratory departs from this description.
        crtk: where its arms and cameras are found on CRTK.
    """

    name: str
    about: str
    arms: Mapping[str, StationArm]
    cameras: Mapping[str, StationCamera]
    T_world_fixture: Mapping[str, SE3] = field(default_factory=dict)
    registration: Registration | CheckerboardRegistration = field(default_factory=Registration)
    min_distance_m: float = 0.0
    difficulty: Difficulty = field(default_factory=lambda: Difficulty.of(DEFAULT))
    crtk: Topics = field(default_factory=Topics)

    def __post_init__(self) -> None:
        require_numbers(self)
        if not self.arms:
            raise InvalidInput(f"station {self.name!r}", "has no arm", "give one or more under [arms.NAME]")

    def __repr__(self) -> str:
        arms = ", ".join(f"{name} ({arm.model.name})" for name, arm in self.arms.items())
        seen = f"; cameras {', '.join(self.cameras)}" if self.cameras else ""
        return f"<Station {self.name!r}: arms {arms}{seen}; flaws {self.difficulty.level}>"

    def _repr_html_(self) -> str:
        arms = (("arm", name, arm.model.name, arm.T_world_base) for name, arm in self.arms.items())
        kinds = {True: "stereo pair", False: "RGBD camera"}
        cameras = (
            ("camera", name, kinds[isinstance(camera.model, StereoRig)], camera.T_world_camera)
            for name, camera in self.cameras.items()
        )
        fixtures = (("fixture", name, "", T) for name, T in self.T_world_fixture.items())
        caption = f"{self!r} {self.about}"
        return table(caption, ("what", "name", "kind", "pose in the world"), (*arms, *cameras, *fixtures))

    def arm(self, name: str) -> StationArm:
        """Return the arm of this name (UnknownName: there is none)."""
        if name not in self.arms:
            raise UnknownName(f"station {self.name!r}: arm", name, self.arms)
        return self.arms[name]

    def calibration_box(self, arm: str) -> MotionBox:
        """Return where an arm moves during a calibration (InvalidInput: the station does not say)."""
        box = self.arm(arm).calibration
        if box is None:
            problem = f"does not define where arm {arm!r} moves during calibration"
            remedy = f"add 'calibration' to [arms.{arm}], or choose a method that needs none"
            raise InvalidInput(f"station {self.name!r}", problem, remedy)
        return box

    @property
    def limits(self) -> dict[str, MotionLimits]:
        """Return the arms' limits by name."""
        return {name: arm.limits for name, arm in self.arms.items()}

    @property
    def models(self) -> dict[str, ArmModel]:
        """Return the arms' models by name."""
        return {name: arm.model for name, arm in self.arms.items()}

    def flaws(self, task: str = "", flawless_camera: bool = False) -> dict[str, str]:
        """Return a description of what is imperfect here for a task, for the summary of a run."""
        found = {"difficulty": ", ".join([self.difficulty.level, *self.difficulty.named])}
        found |= {f"transmission of {name}": arm.transmission.source for name, arm in self.arms.items()}
        found["registration of bases"] = self.registration.about
        registered = {name: arm.T_world_base_registered for name, arm in self.arms.items()}
        registered |= {name: camera.T_world_camera_registered for name, camera in self.cameras.items()}
        if names := [name for name, T in registered.items() if T is not None]:
            found[f"registration of {', '.join(names)}"] = "as the station file has it"
        cameras = "switched off" if flawless_camera else "switched on, as large as the station's file says"
        found |= {f"flaws of camera {name}": cameras for name in self.cameras}
        return found | {
            f"{name}: {FLAWS[name].about}": self.difficulty.shown(name) for name in self.relevant_flaws(task)
        }

    def require_relevant(self, task: str = "") -> Station:
        """Return this station if each flaw with a size of its own has an effect on a task here.

        Raises:
            InvalidInput: a flaw has no effect, so a summary that names it would be misleading.
        """
        relevant = self.relevant_flaws(task)
        for name in self.difficulty.sizes:
            if name not in relevant:
                doing = f"{task!r} at station" if task else "what is done at station"
                raise InvalidInput(
                    f"flaw {name!r}", f"has no effect on {doing} {self.name!r}", f"choose one of {', '.join(relevant)}"
                )
        return self

    def relevant_flaws(self, task: str = "") -> list[str]:
        """Return the names of the flaws that have an effect here: the station's, and those of a task if given."""
        felt = {"jaw", "tool"}.union(*(arm.transmission.flaws for arm in self.arms.values()))
        if isinstance(self.registration, Registration):
            if any(arm.T_world_base_registered is None for arm in self.arms.values()):
                felt.add("registration")
            if any(camera.T_world_camera_registered is None for camera in list(self.cameras.values())[1:]):
                felt.add("cameras")
        if any(isinstance(camera.model, Intrinsics) for camera in self.cameras.values()):
            felt.add("depth")
        return [name for name, flaw in FLAWS.items() if name in felt or task in flaw.tasks]
