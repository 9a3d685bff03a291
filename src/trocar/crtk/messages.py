"""The messages of CRTK's topics as DDS types, named as ROS 2 names them (of crtk_msgs 1.3, cisst_msgs 4.0, ...)."""

# cyclonedds reads the annotations of these classes, so they are not strings here.
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

from cyclonedds.idl import IdlStruct
from cyclonedds.idl._machinery import BytesMachine

if TYPE_CHECKING:
    float64: TypeAlias = float
    int32: TypeAlias = int
    int64: TypeAlias = int
    uint32: TypeAlias = int
    uint8: TypeAlias = int
    sequence = list
    nine = twelve = list[float]
    octets: TypeAlias = bytes
else:
    from cyclonedds.idl.types import array, float64, int32, int64, sequence, uint8, uint32

    nine, twelve, octets = array[float64, 9], array[float64, 12], sequence[uint8]


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    """Seconds since 1970; 0 means that the data are not valid."""

    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    """Time stamp and frame."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class JointState(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
    """Joints in SI units; an empty list means that its values are not available."""

    header: Header = field(default_factory=Header)
    name: sequence[str] = field(default_factory=list)
    position: sequence[float64] = field(default_factory=list)
    velocity: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)


@dataclass
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    """A position, m."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    """A rotation as a quaternion, scalar last."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Pose(IdlStruct, typename="geometry_msgs.msg.dds_.Pose_"):
    """A position and a rotation."""

    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs.msg.dds_.PoseStamped_"):
    """A pose with its time and frame."""

    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    """A velocity, a force or a torque, SI."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Twist(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    """Linear and angular velocity, m/s and rad/s."""

    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass
class TwistStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TwistStamped_"):
    """A velocity with its time and frame."""

    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)


@dataclass
class Wrench(IdlStruct, typename="geometry_msgs.msg.dds_.Wrench_"):
    """Force and torque, N and N m."""

    force: Vector3 = field(default_factory=Vector3)
    torque: Vector3 = field(default_factory=Vector3)


@dataclass
class WrenchStamped(IdlStruct, typename="geometry_msgs.msg.dds_.WrenchStamped_"):
    """A wrench with its time and frame."""

    header: Header = field(default_factory=Header)
    wrench: Wrench = field(default_factory=Wrench)


@dataclass
class MultiArrayDimension(IdlStruct, typename="std_msgs.msg.dds_.MultiArrayDimension_"):
    """One dimension of an array; its stride is the number of values in it and in the dimensions after it."""

    label: str = ""
    size: uint32 = 0
    stride: uint32 = 0


@dataclass
class MultiArrayLayout(IdlStruct, typename="std_msgs.msg.dds_.MultiArrayLayout_"):
    """The dimensions of an array."""

    dim: sequence[MultiArrayDimension] = field(default_factory=list)
    data_offset: uint32 = 0


@dataclass
class Float64MultiArray(IdlStruct, typename="std_msgs.msg.dds_.Float64MultiArray_"):
    """An array, row by row."""

    layout: MultiArrayLayout = field(default_factory=MultiArrayLayout)
    data: sequence[float64] = field(default_factory=list)


@dataclass
class Float64(IdlStruct, typename="std_msgs.msg.dds_.Float64_"):
    """A number."""

    data: float64 = 0.0


@dataclass
class Bool(IdlStruct, typename="std_msgs.msg.dds_.Bool_"):
    """Yes or no."""

    data: bool = False


@dataclass
class StringStamped(IdlStruct, typename="crtk_msgs.msg.dds_.StringStamped_"):
    """A word: enable, disable, pause, resume, home, unhome."""

    header: Header = field(default_factory=Header)
    string: str = ""


@dataclass
class OperatingState(IdlStruct, typename="crtk_msgs.msg.dds_.OperatingState_"):
    """DISABLED, ENABLED, PAUSED or FAULT."""

    header: Header = field(default_factory=Header)
    state: str = ""
    is_homed: bool = False
    is_busy: bool = False


@dataclass
class IntervalStatistics(IdlStruct, typename="cisst_msgs.msg.dds_.IntervalStatistics_"):
    """Periods and computing times of ticks, s; an overrun computes longer than the mean period before."""

    header: Header = field(default_factory=Header)
    period_avg: float64 = 0.0
    period_std_dev: float64 = 0.0
    period_min: float64 = 0.0
    period_max: float64 = 0.0
    compute_time_avg: float64 = 0.0
    compute_time_std_dev: float64 = 0.0
    compute_time_min: float64 = 0.0
    compute_time_max: float64 = 0.0
    number_of_samples: int64 = 0
    number_of_overruns: int64 = 0
    statistics_interval: float64 = 0.0
    user_data: int64 = 0


@dataclass
class OldOperatingState(IdlStruct, typename="crtk_msgs.msg.dds_.operating_state_"):
    """``OperatingState`` before CRTK 1.1, which renamed it."""

    header: Header = field(default_factory=Header)
    state: str = ""
    is_homed: bool = False
    is_busy: bool = False


@dataclass
class Transform(IdlStruct, typename="geometry_msgs.msg.dds_.Transform_"):
    """A pose as a transform."""

    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TransformStamped_"):
    """A pose as CRTK had it before 1.1, and as a Raven has it."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = field(default_factory=Transform)


@dataclass
class Empty(IdlStruct, typename="std_msgs.msg.dds_.Empty_"):
    """Nothing; ROS 2 sends one byte."""

    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class Image(IdlStruct, typename="sensor_msgs.msg.dds_.Image_"):
    """Rows of pixels, ``step`` bytes each: ``rgb8``, ``bgr8``, ``32FC1`` (m) or ``16UC1`` (mm)."""

    header: Header = field(default_factory=Header)
    height: uint32 = 0
    width: uint32 = 0
    encoding: str = ""
    is_bigendian: uint8 = 0
    step: uint32 = 0
    data: octets = b""


_idl: Any = getattr(Image, "__idl__")  # noqa: B009
_idl.populate()
for _machine in (_idl.v1_machine, _idl.v2_machine):  # as a list of numbers, a megabyte takes a good part of a second
    _machine.members_machines["data"] = BytesMachine()


@dataclass
class RegionOfInterest(IdlStruct, typename="sensor_msgs.msg.dds_.RegionOfInterest_"):
    """A rectangle of pixels."""

    x_offset: uint32 = 0
    y_offset: uint32 = 0
    height: uint32 = 0
    width: uint32 = 0
    do_rectify: bool = False


@dataclass
class CameraInfo(IdlStruct, typename="sensor_msgs.msg.dds_.CameraInfo_"):
    """A lens: size in pixels, distortion k1 k2 p1 p2 k3, matrices K, R, P row by row."""

    header: Header = field(default_factory=Header)
    height: uint32 = 0
    width: uint32 = 0
    distortion_model: str = ""
    d: sequence[float64] = field(default_factory=list)
    k: nine = field(default_factory=lambda: [0.0] * 9)
    r: nine = field(default_factory=lambda: [0.0] * 9)
    p: twelve = field(default_factory=lambda: [0.0] * 12)
    binning_x: uint32 = 0
    binning_y: uint32 = 0
    roi: RegionOfInterest = field(default_factory=RegionOfInterest)


def ros_name(kind: type) -> str:
    """Return what ROS calls a message: ``sensor_msgs/JointState``."""
    package, *_, name = kind.__idl_typename__.split(".")  # type: ignore[attr-defined]
    return f"{package}/{name.removesuffix('_')}"


EFFORTS: dict[str, type] = {
    **dict.fromkeys(("servo_jf", "jaw/servo_jf"), JointState),
    **dict.fromkeys(("body/servo_cf", "spatial/servo_cf"), WrenchStamped),
    **dict.fromkeys(("use_gravity_compensation", "body/set_cf_orientation_absolute"), Bool),
    "free": Empty,
}
"""Topics, below an arm's namespace, that drive it by efforts."""
