"""A trial as an MCAP file, for Foxglove and every other program that reads ROS 2 messages."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from heapq import merge
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.arms import fk
from trocar.bags.mcap_file import McapFile, kind, stamp, stamped
from trocar.bags.reader import NS_PER_S
from trocar.bags.scene import markers
from trocar.errors import InvalidInput
from trocar.eval.trial import Trial
from trocar.files.output import mark_of, writing
from trocar.geometry import SE3
from trocar.lab import StationCamera, load_station
from trocar.lab.station_file import station_digest
from trocar.lab.topics import Topics
from trocar.perception.image import Intrinsics

KIND = "recording of a trial"
START_NS = 946_684_800 * NS_PER_S
"""The stamp of the trial's beginning, 2000-01-01: a stamp of 0 means that data are not valid."""
KINDS = {"desired": "desired", "commanded": "setpoint", "measured": "measured", "true": "true"}
"""A trial's arrays of an arm, and CRTK's words for them; CRTK has none for desired and true joints."""
WORLD = "world"
INFO, WARN, ERROR = 20, 30, 40

JointState, CompressedImage = kind("sensor_msgs", "JointState"), kind("sensor_msgs", "CompressedImage")
RawImage = kind("sensor_msgs", "Image")
CameraInfo, Region = kind("sensor_msgs", "CameraInfo"), kind("sensor_msgs", "RegionOfInterest")
PoseStamped, Pose = kind("geometry_msgs", "PoseStamped"), kind("geometry_msgs", "Pose")
Point, Quaternion = kind("geometry_msgs", "Point"), kind("geometry_msgs", "Quaternion")
Transform, Vector = kind("geometry_msgs", "Transform"), kind("geometry_msgs", "Vector3")
TransformStamped, Transforms = kind("geometry_msgs", "TransformStamped"), kind("tf2_msgs", "TFMessage")
Log, String = kind("rcl_interfaces", "Log"), kind("std_msgs", "String")

Message = tuple[int, str, Any]
"""Stamp in ns, topic, message."""


def write_mcap(trial: Trial, path: str | Path) -> dict[str, int]:
    """Write a trial as an MCAP file, and return the number of messages by topic; the same trial gives the same bytes.

    For an arm psm1, ``/PSM1/measured_js`` has the joints at 100 Hz, ``/PSM1/jaw/measured_js`` the jaws,
    ``/PSM1/measured_cp`` the tip in the world, likewise ``setpoint_`` (commanded), ``desired_`` and ``true_``;
    ``/PSM1/span`` what its script was doing. ``/tf`` and ``/tf_static`` have the bodies, ``/scene`` their solids,
    ``/CAMERA/image/compressed`` and ``/CAMERA/depth/image`` the images, ``/log`` events, the referee's scores and
    collisions.

    Raises:
        BadFile: something else is already there.
        MachineError: it cannot be written.
    """
    counts: dict[str, int] = {}
    with writing(path, KIND) as draft, draft.open("wb") as file:
        recording = McapFile(file, mark_of(KIND))
        sources = (_fixed(trial), _joints(trial), _moving(trial), _spans(trial), _images(trial), _log(trial))
        for stamp_ns, topic, message in merge(*sources, key=lambda one: one[0]):
            recording.write(topic, stamp_ns, message)
            counts[topic] = counts.get(topic, 0) + 1
        recording.close()
    return counts


def _at_ns(time_s: float) -> int:
    return START_NS + round(time_s * NS_PER_S)


def _fixed(trial: Trial) -> Iterator[Message]:
    """Yield what does not change: bodies that never move, cameras, solids."""
    fixed = dict(trial.scenery.T_world_body)
    for name, camera in _cameras(trial).items():
        fixed[name] = camera.T_world_camera_registered or camera.T_world_camera
    frames = [name for name in fixed if name != WORLD]
    yield START_NS, "/tf_static", Transforms([_transform(START_NS, name, *_parts(fixed[name])) for name in frames])
    yield START_NS, "/scene", markers(trial.scenery.solids, START_NS)


def _joints(trial: Trial) -> Iterator[Message]:
    """Yield joints, jaws and tips of all arms, tick by tick."""
    nothing, scenery = np.zeros(0), trial.scenery
    series = []
    for name, arm in scenery.arms.items():
        joints = [joint.name for joint in arm.joints]
        for key, word in KINDS.items():
            if f"{key}_{name}" not in trial.arrays:
                continue
            rows = trial.arrays[f"{key}_{name}"].astype(np.float64)
            bases = scenery.T_world_base if key == "true" else scenery.T_world_base_registered
            series.append((Topics().of_arm(name), word, joints, rows, *_parts(bases[name] @ fk(arm, rows[:, :6]))))
    for tick, time_s in enumerate(trial.times_s):
        at_ns = _at_ns(time_s)
        for arm, word, joints, rows, places, turns in series:
            q, jaw = rows[tick, :6], rows[tick, 6:]
            yield at_ns, f"{arm}/{word}_js", JointState(stamped(at_ns), joints, q, nothing, nothing)
            yield at_ns, f"{arm}/jaw/{word}_js", JointState(stamped(at_ns), ["jaw"], jaw, nothing, nothing)
            tip = Pose(Point(*places[tick]), _quaternion(turns[tick]))
            yield at_ns, f"{arm}/{word}_cp", PoseStamped(stamped(at_ns, WORLD), tip)


def _moving(trial: Trial) -> Iterator[Message]:
    """Yield the poses of all bodies that move, as they truly were."""
    bodies = {name: T for name, T in trial.replay().T_world_body.items() if name not in trial.scenery.T_world_body}
    parts = {name: _parts(T) for name, T in bodies.items()}
    for tick, time_s in enumerate(trial.times_s):
        at_ns = _at_ns(time_s)
        transforms = [_transform(at_ns, name, p[tick], turn[tick]) for name, (p, turn) in parts.items()]
        yield at_ns, "/tf", Transforms(transforms)


def _spans(trial: Trial) -> Iterator[Message]:
    """Yield the names of each arm's spans that are under way, whenever they change."""
    found = []
    for name in trial.scenery.arms:
        mine = [span for span in trial.spans if span.arm == name]
        for time_s in sorted({0.0, *(s.start_s for s in mine), *(s.end_s for s in mine)}):
            under_way = [span.name for span in mine if span.start_s <= time_s < span.end_s]
            found.append((_at_ns(time_s), f"{Topics().of_arm(name)}/span", String(", ".join(under_way))))
    yield from sorted(found, key=lambda one: one[0])


def _images(trial: Trial) -> Iterator[Message]:
    """Yield the images as they were saved, with the lens if it is a whole image of one of the station's cameras."""
    known, blobs = _cameras(trial), trial.images
    taken = [(at_s, name, blob) for name, images in trial.scenery.cameras.items() for at_s, blob in images]
    for time_s, name, blob in sorted(one for one in taken if one[2] in blobs):
        at_ns, topic = _at_ns(time_s), Topics().of_camera(name)
        picture, encoding = _opened(blobs[blob])
        data = np.frombuffer(blobs[blob], dtype=np.uint8)
        yield at_ns, f"{topic}/image/compressed", CompressedImage(stamped(at_ns, name), encoding, data)
        lens = known[name].model_registered if name in known else None
        whole = lens if isinstance(lens, Intrinsics) and (lens.height, lens.width) == picture.shape[:2] else None
        if whole:
            yield at_ns, f"{topic}/camera_info", _camera_info(at_ns, name, whole)
        packed = blobs.get(blob.replace(".webp", "_depth.png"))
        if packed:
            depth_mm = _opened(packed)[0].astype("<u2")
            rows, columns = depth_mm.shape
            pixels = depth_mm.view(np.uint8).ravel()
            header = stamped(at_ns, name)
            yield at_ns, f"{topic}/depth/image", RawImage(header, rows, columns, "16UC1", 0, 2 * columns, pixels)
            if whole:
                yield at_ns, f"{topic}/depth/camera_info", _camera_info(at_ns, name, _thinned(whole, columns, rows))


def _opened(file: bytes) -> tuple[NDArray[Any], str]:
    """Return the pixels of a picture, and what its format is called."""
    with Image.open(BytesIO(file)) as picture:
        return np.asarray(picture), str(picture.format).lower()


def _thinned(lens: Intrinsics, width: int, height: int) -> Intrinsics:
    """Return the lens of an image that has every n-th pixel of each row and column, the first one included."""
    n = -(-lens.width // width)
    return Intrinsics(width, height, lens.fx / n, lens.fy / n, lens.cx / n, lens.cy / n, lens.distortion)


def _log(trial: Trial) -> Iterator[Message]:
    """Yield events, scores and collisions as log messages of JSON, warnings where something went wrong."""
    noted: list[tuple[float, int, str, dict[str, Any]]] = []
    for event in trial.events:
        more = {key: value for key, value in event.items() if key not in ("name", "time_s")}
        level = INFO if more.get("outcome", "DONE") == "DONE" else WARN
        noted.append((event["time_s"], level, event["name"], more))
    for number, score in enumerate(trial.scores):
        if score["attempted"]:
            more = {key: value for key, value in score.items() if key not in ("attempted", "end_s")}
            level = INFO if score["succeeded"] else WARN
            noted.append((score["end_s"], level, f"referee: {trial.goal_noun}", {"goal": number, **more}))
    for hit in trial.collisions:
        noted.append((hit["time_s"], WARN, "referee: collision", {k: v for k, v in hit.items() if k != "time_s"}))
    end = {"ended": trial.ended, "reason": trial.reason}
    noted.append((trial.duration_s, INFO if trial.finished else ERROR, "end", end))
    for time_s, level, name, more in sorted(noted, key=lambda one: one[0]):
        at_ns = _at_ns(time_s)
        yield at_ns, "/log", Log(stamp(at_ns), level, name, json.dumps(more, sort_keys=True), "", "", 0)


def _cameras(trial: Trial) -> dict[str, StationCamera]:
    """Return the cameras of the trial's station; none if the station's file has changed since the trial."""
    name = trial.about["station"]
    try:
        return dict(load_station(name).cameras) if station_digest(name) == trial.about["station_digest"] else {}
    except InvalidInput:
        return {}


def _camera_info(at_ns: int, frame: str, lens: Intrinsics) -> Any:
    k, p = lens.matrix, np.column_stack([lens.matrix, np.zeros(3)])
    whole = Region(0, 0, 0, 0, False)
    header, d = stamped(at_ns, frame), np.array(lens.distortion)
    return CameraInfo(
        header, lens.height, lens.width, "plumb_bob", d, k.ravel(), np.eye(3).ravel(), p.ravel(), 0, 0, whole
    )


def _parts(T: SE3) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions (..., 3) in m and quaternions (..., 4) wxyz."""
    return T.translation_m, T.rotation.as_quaternion()


def _quaternion(wxyz: Sequence[float] | NDArray[np.float64]) -> Any:
    w, x, y, z = wxyz
    return Quaternion(x, y, z, w)


def _transform(at_ns: int, frame: str, place_m: NDArray[np.float64], wxyz: NDArray[np.float64]) -> Any:
    return TransformStamped(stamped(at_ns, WORLD), frame, Transform(Vector(*place_m), _quaternion(wxyz)))
