"""Cameras in a bag: their images as files, with stamps and lenses in a JSON file beside them."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.bags.reader import Bag, stamp_ns
from trocar.errors import BadFile, InvalidInput
from trocar.files.output import make_folder, require_place, write_json, writing
from trocar.perception.image import Intrinsics

RAW, COMPRESSED, INFO = "sensor_msgs/Image", "sensor_msgs/CompressedImage", "sensor_msgs/CameraInfo"
KIND = "list of images"
LIST = "images.json"
SUFFIXES = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg", b"RIFF": ".webp"}
"""How compressed images begin that are kept as they are."""
IMAGE_FILE = re.compile(r"\d{6}\.(png|jpg|webp|npy)")
CHANNELS = {
    **{"rgb8": (0, 1, 2), "8UC3": (2, 1, 0), "bgr8": (2, 1, 0), "rgba8": (0, 1, 2), "bgra8": (2, 1, 0)},
    **{"mono8": (0,), "8UC1": (0,)},
}
"""Where red, green and blue are in a pixel of 8 bits a channel; 8UC3 is OpenCV's blue, green, red."""
BYTES = {"rgba8": 4, "bgra8": 4}
DEEP = {"mono16": "u2", "16UC1": "u2", "32FC1": "f4"}
"""Depth, in mm and m, and grey of 16 bits: one number a pixel."""


@dataclass(frozen=True)
class CameraFiles:
    """The images of one topic, as files."""

    topic: str
    list: Path
    """The file with their names, their stamps and the lens."""
    images: int
    lens: Intrinsics | None
    """None: the bag has no camera info for it, or of a lens with another distortion than Brown's."""
    unstamped: int
    """Images with a stamp of 0, left out."""
    unknown: dict[str, int]
    """How many were left out by encoding, because it cannot be read."""


def cameras_in(bag: Bag) -> list[str]:
    """Return the topics with images."""
    return [topic.name for topic in bag.of_kind(RAW, COMPRESSED)]


def write_images(bag: Bag, folder: str | Path, cameras: list[str]) -> list[CameraFiles]:
    """Write the images of topics into a folder each, and return what was written.

    Images of 8 and 16 bits become PNG files, those of floating point ``.npy``; compressed ones stay as they are. Beside
    them, ``images.json`` has ``topic``, ``frame``, ``intrinsics`` (the fields of ``Intrinsics``, or null), and for each
    image its ``file`` and ``stamp_ns``, since 1970.

    Args:
        bag: in which they are.
        folder: made if it is not there.
        cameras: topics; empty: all with images.

    Raises:
        InvalidInput: there is no such topic, or it has no images; a file is in the way.
        BadFile: the bag is damaged.
        MachineError: a file cannot be written.
    """
    if not cameras and not cameras_in(bag):
        raise InvalidInput(f"bag {str(bag.path)!r}", "holds no images", "leave --images out")
    for name in cameras:
        bag.topic(name, RAW, COMPRESSED)
    return [_write_camera(bag, Path(folder), name) for name in cameras or cameras_in(bag)]


def _write_camera(bag: Bag, folder: Path, topic: str) -> CameraFiles:
    place = make_folder(folder / topic.strip("/").replace("/", "_"))
    listed = require_place(place / LIST, KIND)
    _clear(place)
    write_json(listed, {"topic": topic, "images": []}, KIND)  # whose the images are, should this be interrupted
    unstamped, unknown, frame = 0, dict[str, int](), ""
    images: list[dict[str, Any]] = []
    for _, message in bag.messages([topic]):
        if not stamp_ns(message):
            unstamped += 1
            continue
        found = _file_of(topic, message)
        if found is None:
            what = str(getattr(message, "encoding", "")) or str(message.format)
            unknown[what] = unknown.get(what, 0) + 1
            continue
        suffix, content = found
        name, frame = f"{len(images):06d}{suffix}", message.header.frame_id
        with writing(place / name, "image") as draft:
            draft.write_bytes(content)
        images.append({"file": name, "stamp_ns": stamp_ns(message)})
    lens = _lens(bag, topic)
    values = {"topic": topic, "frame": frame, "intrinsics": asdict(lens) if lens else None, "images": images}
    write_json(listed, values, KIND)
    return CameraFiles(topic, listed, len(images), lens, unstamped, unknown)


def _clear(place: Path) -> None:
    """Remove the images of an earlier import.

    Raises:
        BadFile: the folder holds something else.
    """
    inside = {file.name for file in place.iterdir()}
    if inside and LIST not in inside:
        raise BadFile(place, f"holds files, but no {LIST} of an earlier import", "give another", kind="folder")
    for name in inside:
        if IMAGE_FILE.fullmatch(name):
            (place / name).unlink()


def _file_of(topic: str, message: Any) -> tuple[str, bytes] | None:
    """Return suffix and bytes of the file of an image; None if its encoding is unknown."""
    if hasattr(message, "format"):
        content = bytes(message.data)
        return next(((suffix, content) for magic, suffix in SUFFIXES.items() if content.startswith(magic)), None)
    if message.encoding in DEEP:
        values = _pixels(topic, message, DEEP[message.encoding], 1)[:, :, 0]
        file = BytesIO()
        if values.dtype.kind == "f":
            np.save(file, values.astype(np.float32), allow_pickle=False)
            return ".npy", file.getvalue()
        Image.fromarray(values.astype(np.uint16)).save(file, "png")
        return ".png", file.getvalue()
    if message.encoding not in CHANNELS:
        return None
    order, file = CHANNELS[message.encoding], BytesIO()
    values = _pixels(topic, message, "u1", BYTES.get(message.encoding, len(order)))
    Image.fromarray(values[:, :, 0] if len(order) == 1 else values[:, :, order]).save(file, "png")
    return ".png", file.getvalue()


def _pixels(topic: str, message: Any, kind: str, channels: int) -> NDArray[Any]:
    """Return the pixels (height, width, channels) of a raw image; rows may be padded, and bytes swapped."""
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    used = message.width * channels * dtype.itemsize
    data = np.asarray(message.data, dtype=np.uint8)
    if message.step < used or len(data) != message.step * message.height or not used:
        size = f"{message.width} x {message.height} pixels of {message.encoding}"
        problem = f"has an image of {size} in {len(data)} bytes of {message.step} a row"
        raise InvalidInput(f"topic {topic!r}", problem, "record it again, or leave it out by naming others (--camera)")
    rows = np.ascontiguousarray(data.reshape(message.height, message.step)[:, :used])
    return rows.view(dtype).reshape(message.height, message.width, channels)


def _lens(bag: Bag, topic: str) -> Intrinsics | None:
    """Return the lens from the camera info beside a topic, or beside the one of which it is the compression."""
    beside = topic.rpartition("/")[0]
    places = [beside, beside.rpartition("/")[0]] if bag.topics[topic].kind == COMPRESSED else [beside]
    known = {info.name for info in bag.of_kind(INFO)}
    for name in (f"{place}/camera_info" for place in places):
        if name in known:
            _, message = next(bag.messages([name]))
            return _intrinsics(message)
    return None


def _intrinsics(info: Any) -> Intrinsics | None:
    ros1 = hasattr(info, "K")
    k, d = (info.K, info.D) if ros1 else (info.k, info.d)
    k, d = [float(v) for v in k], [float(v) for v in d]
    if (len(d) > 5 and any(d[5:])) or not k[0] or info.distortion_model not in ("", "plumb_bob"):
        return None
    k1, k2, p1, p2, k3 = [*d, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    return Intrinsics(int(info.width), int(info.height), k[0], k[4], k[2], k[5], (k1, k2, p1, p2, k3))
