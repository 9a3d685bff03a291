"""Bags of every kind, written by rosbags' own writers."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
FORMS = ("ros1", "sqlite", "mcap")
START_S = 1_700_000_000
"""When the bags begin, seconds since 1970."""
PSM = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")


def header(at_s: float | None, frame: str = ""):
    """Return a maker of a Header stamped ``at_s`` after the bag's beginning; None: a stamp of 0, not valid."""

    def made(store):
        time = store.types["builtin_interfaces/msg/Time"]
        ns = 0 if at_s is None else START_S * 10**9 + round(at_s * 1e9)
        fields = {"stamp": time(ns // 10**9, ns % 10**9), "frame_id": frame}
        return store.types["std_msgs/msg/Header"](**({"seq": 0} if store is ROS1 else {}), **fields)

    return made


def joints(at_s, position, names=PSM):
    """Return type and fields of a JointState, for ``message`` of either ROS."""
    nothing = np.zeros(0)
    values = {"position": np.array(position, dtype=float), "velocity": nothing, "effort": nothing}
    return "sensor_msgs/msg/JointState", {"header": header(at_s), "name": list(names), **values}


def compressed(at_s, content, kind="jpeg"):
    """Return type and fields of a CompressedImage."""
    data = np.frombuffer(content, np.uint8)
    return "sensor_msgs/msg/CompressedImage", {"header": header(at_s, "eye"), "format": kind, "data": data}


def raw(at_s, pixels, encoding, *, padding=0, big=False):
    """Return type and fields of an Image of pixels (h, w) or (h, w, channels), its rows padded by some bytes."""
    pixels = np.asarray(pixels)
    data = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<")).tobytes()
    rows = np.frombuffer(data, np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    size = {"height": pixels.shape[0], "width": pixels.shape[1], "step": rows.shape[1]}
    values = {"encoding": encoding, "is_bigendian": int(big), "data": rows.ravel(), **size}
    return "sensor_msgs/msg/Image", {"header": header(at_s, "eye"), **values}


def camera_info(at_s, size, k, d, model="plumb_bob", *, p=(0.0,) * 12, binning=(0, 0), roi=(0, 0, 0, 0)):
    """Return type and fields of a CameraInfo; ``roi`` is x, y, width and height."""

    def region(store):
        x, y, width, height = roi
        return store.types["sensor_msgs/msg/RegionOfInterest"](x, y, height, width, False)

    numbers = {"binning_x": binning[0], "binning_y": binning[1], "roi": region}
    fields = {"header": header(at_s, "eye"), "height": size[1], "width": size[0], "distortion_model": model}
    matrices = {"d": np.array(d, dtype=float), "k": np.array(k, dtype=float), "r": np.eye(3).ravel()}
    return "sensor_msgs/msg/CameraInfo", {**fields, **matrices, "p": np.array(p, dtype=float), **numbers}


def packed(image, kind):
    """Return an image as the bytes of a file of this kind."""
    file = BytesIO()
    Image.fromarray(image).save(file, kind)
    return file.getvalue()


def message(store, kind, fields):
    """Return the bytes of a message; in ROS 1, the matrices of a CameraInfo have capital names."""
    capital = store is ROS1 and kind.endswith("CameraInfo")
    values = {
        (key.upper() if capital and len(key) == 1 else key): value(store) if callable(value) else value
        for key, value in fields.items()
    }
    encode = store.serialize_ros1 if store is ROS1 else store.serialize_cdr
    return bytes(encode(store.types[kind](**values), kind))


def write_bag(
    folder: Path, form: str, topics: dict[str, list[tuple[str, dict[str, Any]]]], silent: Sequence[str] = ()
) -> Path:
    """Write a bag, each topic's messages 10 ms apart, and return the path that a user would give.

    ``silent`` are topics of joints without any message.
    """
    store = ROS1 if form == "ros1" else ROS2
    path = folder / ("bag.bag" if form == "ros1" else f"bag_{form}")
    with ExitStack() as stack:
        if form == "ros1":
            writer: Any = stack.enter_context(Writer1(path))
        else:
            plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
            writer = stack.enter_context(Writer2(path, version=9, storage_plugin=plugin))
        for topic in silent:
            writer.add_connection(topic, "sensor_msgs/msg/JointState", typestore=store)
        for topic, messages in topics.items():
            connections: dict[str, Any] = {}
            for number, (kind, fields) in enumerate(messages):
                if kind not in connections:
                    connections[kind] = writer.add_connection(topic, kind, typestore=store)
                writer.write(connections[kind], START_S * 10**9 + number * 10**7, message(store, kind, fields))
    return path
