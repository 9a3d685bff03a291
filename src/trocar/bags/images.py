"""Cameras in a bag: their images as files, with stamps and lenses in a JSON file beside them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from io import BytesIO
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from trocar.bags.reader import Bag, stamp_ns
from trocar.errors import BadFile, InvalidInput
from trocar.files.output import blame, clear_drafts, make_folder, require_place, write_json
from trocar.files.ros_image import ENCODINGS, Damaged, pixels
from trocar.perception.image import Intrinsics

RAW, COMPRESSED, INFO = "sensor_msgs/Image", "sensor_msgs/CompressedImage", "sensor_msgs/CameraInfo"
KIND = "list of images"
LIST = "images.json"
SUFFIXES = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg", b"RIFF": ".webp"}
"""First bytes of compressed images that are kept as they are."""
IMAGE_FILE = re.compile(r"\d{6}\.(png|jpg|webp|npy)")
RECTIFIED = re.compile("(?<![a-z])rect", re.IGNORECASE)
"""Part of a topic's name that tells that its images are rectified: ``image_rect_color``."""


@dataclass(frozen=True)
class CameraFiles:
    """The images of one topic, as files."""

    topic: str
    list: Path
    """The file with their names, their stamps and the lens."""
    images: int
    lens: Intrinsics | None
    """None: the bag has no camera info for it, or only one of another size or another distortion model than Brown's."""
    unstamped: int
    """Images with a stamp of 0, left out."""
    unknown: dict[str, int]
    """Number of images left out because their encoding cannot be read, by encoding."""
    damaged: int
    """Images left out because their bytes are no image, or not one of the size that they claim."""


class _Picture(NamedTuple):
    """An image as a file: how its name ends, its bytes, and its width and height in pixels."""

    suffix: str
    content: bytes
    size: tuple[int, int]


def cameras_in(bag: Bag) -> list[str]:
    """Return the topics with images."""
    return [topic.name for topic in bag.of_kind(RAW, COMPRESSED)]


def write_images(bag: Bag, folder: str | Path, cameras: list[str]) -> list[CameraFiles]:
    """Write the images of topics into a folder each, and return what was written.

    Images of 8 and 16 bits become PNG files, those of floating point ``.npy``; compressed ones stay as they are. Beside
    them, ``images.json`` has ``topic``, ``frame``, ``intrinsics`` (the fields of ``Intrinsics``, or null), ``file`` and
    ``stamp_ns`` (since 1970) of each image, and ``complete``, which is false until all are written.

    Args:
        bag: with the images.
        folder: made if it is not there.
        cameras: topics; empty: all with images.

    Raises:
        InvalidInput: there is no such topic, it has no images, or two would have the same folder; a file is in the way.
        BadFile: the bag is damaged.
        MachineError: a file cannot be written.
    """
    if not cameras and not cameras_in(bag):
        raise InvalidInput(f"bag {str(bag.path)!r}", "holds no images", "leave --images out")
    chosen = list(dict.fromkeys(cameras)) or cameras_in(bag)
    for name in chosen:
        bag.topic(name, RAW, COMPRESSED)
    return [_write_camera(bag, Path(folder) / name, topic) for topic, name in _folders(chosen).items()]


def _folders(topics: Sequence[str]) -> dict[str, str]:
    """Return the name of the folder of each topic."""
    names = {topic: topic.strip("/").replace("/", "_") for topic in topics}
    for name, count in Counter(names.values()).items():
        if count > 1:
            which = " and ".join(topic for topic in topics if names[topic] == name)
            remedy = "import them one by one (--camera), each into a folder of its own"
            raise InvalidInput(f"topics {which}", f"would both be written into {name!r}", remedy)
    return names


def _write_camera(bag: Bag, folder: Path, topic: str) -> CameraFiles:
    place = make_folder(folder)
    clear_drafts(place)
    listed = require_place(place / LIST, KIND)
    _require_ours(place)
    # images carry no mark: this list says that they are ours, and not complete if the import is interrupted
    write_json(listed, {"topic": topic, "complete": False, "images": []}, KIND)
    for file in place.iterdir():
        if IMAGE_FILE.fullmatch(file.name):
            file.unlink()
    unstamped, damaged, unknown, frame = 0, 0, Counter[str](), ""
    images: list[dict[str, Any]] = []
    sizes: set[tuple[int, int]] = set()
    for _, message in bag.messages([topic]):
        if not stamp_ns(message):
            unstamped += 1
            continue
        try:
            picture = _picture(message)
        except Damaged:
            damaged += 1
            continue
        if picture is None:
            unknown[message.format if hasattr(message, "format") else message.encoding] += 1
            continue
        name, frame = f"{len(images):06d}{picture.suffix}", message.header.frame_id
        _write(place / name, picture.content)
        images.append({"file": name, "stamp_ns": stamp_ns(message)})
        sizes.add(picture.size)
    lens = _lens(bag, topic, sizes)
    values = {"topic": topic, "frame": frame, "complete": True, "intrinsics": asdict(lens) if lens else None}
    write_json(listed, {**values, "images": images}, KIND)
    return CameraFiles(topic, listed, len(images), lens, unstamped, dict(unknown), damaged)


def _write(path: Path, content: bytes) -> None:
    """Write an image without a draft, which would scan the folder; the list shows that the folder is ours."""
    try:
        path.write_bytes(content)
    except OSError as error:
        raise blame(error)(f"cannot write {str(path)!r} ({error.strerror or error}); choose another folder") from None


def _require_ours(place: Path) -> None:
    """Raise BadFile if a folder holds files, but not the list of an earlier import."""
    inside = {file.name for file in place.iterdir()}
    if inside and LIST not in inside:
        raise BadFile(place, f"holds files, but no {LIST} of an earlier import", "give another", kind="folder")


def _picture(message: Any) -> _Picture | None:
    """Return an image as a file; None if its encoding is unknown.

    Raises:
        Damaged: the message is no image, or not of the size that it claims.
    """
    if hasattr(message, "format"):
        return _compressed(bytes(message.data))
    if message.encoding not in ENCODINGS:
        return None
    values = pixels(message)
    file, suffix = BytesIO(), ".npy" if values.dtype.kind == "f" else ".png"
    if suffix == ".npy":
        np.save(file, values, allow_pickle=False)
    else:
        Image.fromarray(values).save(file, "png")
    return _Picture(suffix, file.getvalue(), (message.width, message.height))


def _compressed(content: bytes) -> _Picture | None:
    """Return a compressed image as it is; raises as ``_picture`` does."""
    suffix = next((suffix for magic, suffix in SUFFIXES.items() if content.startswith(magic)), None)
    if suffix is None:
        return None
    try:
        with Image.open(BytesIO(content)) as picture:
            size = picture.size
            picture.draft(None, (1, 1))  # coarsely, where the format allows that: only to see that nothing is cut off
            picture.load()
            return _Picture(suffix, content, size)
    except (OSError, ValueError, Image.DecompressionBombError):
        raise Damaged from None


def _lens(bag: Bag, topic: str, sizes: set[tuple[int, int]]) -> Intrinsics | None:
    """Return the lens from the camera info beside a topic, or beside the raw topic of a compressed one.

    None if there is no usable camera info, or there are images but none of its size (width, height).
    """
    beside = topic.rpartition("/")[0]
    places = [beside, beside.rpartition("/")[0]] if bag.topics[topic].kind == COMPRESSED else [beside]
    known = {info.name for info in bag.of_kind(INFO)}
    rectified = bool(RECTIFIED.search(topic.removesuffix("/compressed").rpartition("/")[2]))
    for name in (f"{place}/camera_info" for place in places):
        if name in known:
            lenses = (_intrinsics(message, rectified) for _, message in bag.messages([name]))
            lens = next(filter(None, lenses), None)  # drivers may begin with one of zeros
            return lens if lens and (not sizes or (lens.width, lens.height) in sizes) else None
    return None


def _intrinsics(info: Any, rectified: bool) -> Intrinsics | None:
    """Return the lens of a camera's images: of its region of interest, with binned pixels."""
    k, d, p = (info.K, info.D, info.P) if hasattr(info, "K") else (info.k, info.d, info.p)
    fx, cx, fy, cy = (float(v) for v in (p[[0, 2, 5, 6]] if rectified else k[[0, 2, 4, 5]]))
    d = [] if rectified else [float(v) for v in d]
    browns = rectified or (info.distortion_model in ("", "plumb_bob") and not any(d[5:]))
    if not browns or not all(map(isfinite, (fx, fy, cx, cy, *d))) or min(fx, fy) <= 0:
        return None
    roi, across, down = info.roi, info.binning_x or 1, info.binning_y or 1
    size = (roi.width or info.width) // across, (roi.height or info.height) // down
    # the centre of the first binned pixel is the middle of the pixels that it combines
    cx, cy = (cx - roi.x_offset - (across - 1) / 2) / across, (cy - roi.y_offset - (down - 1) / 2) / down
    k1, k2, p1, p2, k3 = [*d, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    return Intrinsics(*size, fx / across, fy / down, cx, cy, (k1, k2, p1, p2, k3))
