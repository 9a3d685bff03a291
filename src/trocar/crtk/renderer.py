"""The process that renders and publishes a served cell's images, so that the arms' ticks do not wait for them."""

from __future__ import annotations

import contextlib
import os
import signal
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np

from trocar.crtk.bus import Bus, open_bus
from trocar.crtk.images import color_message, depth_message, info_message, parts_of
from trocar.crtk.messages import CameraInfo, Header, Image
from trocar.eval.staged import Files, image_files
from trocar.hardware.priority import ahead_of_others
from trocar.lab.topics import Topics
from trocar.perception.image import Image as Taken
from trocar.perception.image import StereoImage, StereoRig
from trocar.sim.cameras import CameraRenderer
from trocar.sim.world import WorldCopy

PRIORITY = 1
"""Real-time priority, below the arms' and above ordinary processes: a real camera does not wait for programs."""
NICE = 5
"""Added to the process's niceness where real-time priority is not permitted, because the arms come first."""
QUIET_S = 0.3
"""Kept images are packed after this long without a request."""


@dataclass(frozen=True)
class Exposure:
    """A request for an image of the cell in one state.

    Attributes:
        camera: name.
        header: of its messages: the time of the exposure.
        state: of the physics.
        kept: it was triggered, so it is kept for the trial's file; else it is made only if anybody subscribes.
    """

    camera: str
    header: Header
    state: bytes
    kept: bool


@dataclass(frozen=True)
class Studio:
    """What the process needs.

    Attributes:
        renderers: of the cameras by name, all of one world.
        noise: random numbers for the sensor noise of images that are kept.
        topics: where to publish.
    """

    renderers: Mapping[str, CameraRenderer]
    noise: np.random.Generator
    topics: Topics


def render_for_ever(studio: Studio, asked: Connection) -> None:
    """Publish an image for each exposure, and answer it with True; answer None with the files of all kept images."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # clients may still want an image; this process ends with its parent
    lens = next(iter(studio.renderers.values())).lenses[0]
    copy, free = WorldCopy(lens.model), np.random.default_rng(0)
    for renderer in studio.renderers.values():
        renderer.image(copy.data, free)  # what never moves is rendered once, for all images
    bus = open_bus(studio.topics)
    cameras = {
        name: CameraTopics(bus, studio.topics.of_camera(name), name, renderer)
        for name, renderer in studio.renderers.items()
    }
    kept = Kept(tuple(cameras))
    asked.send(True)
    with ahead_of_others(PRIORITY) as permitted, contextlib.suppress(EOFError, OSError):
        if not permitted:
            os.nice(NICE)
        while True:
            while kept.waiting and not asked.poll(QUIET_S):
                kept.pack()
            order: Exposure | None = asked.recv()
            if order is None:
                asked.send(kept.files())
                continue
            if order.kept or cameras[order.camera].wanted():
                copy.put(order.state)
                image = studio.renderers[order.camera].image(copy.data, studio.noise if order.kept else free)
                cameras[order.camera].publish(image, order.header)
                if order.kept:
                    kept.add(order.camera, image)
            asked.send(True)


class CameraTopics:
    """The topics of one camera: an RGBD camera's colours and depth, or a pair's left and right, with their lenses."""

    def __init__(self, bus: Bus, topic: str, name: str, renderer: CameraRenderer):
        self._model, self._parts = renderer.model, parts_of(renderer.model)
        pair = isinstance(renderer.model, StereoRig)
        self._frames = [f"{name}_{part}_optical" if pair else f"{name}_optical" for part in self._parts]
        self._images = [bus.publisher(f"{topic}/{part}/image_raw", Image) for part in self._parts]
        self._infos = [bus.publisher(f"{topic}/{part}/camera_info", CameraInfo, latched=True) for part in self._parts]
        self._send_infos(Header())

    def wanted(self) -> bool:
        """Return whether anybody subscribes to an image."""
        return any(publisher.readers() for publisher in self._images)

    def publish(self, image: Taken, header: Header) -> None:
        """Publish an image, both parts with the same stamp, and the lenses."""
        first, second = (Header(header.stamp, frame) for frame in self._frames)
        if isinstance(image, StereoImage):
            messages = color_message(image.left, first), color_message(image.right, second)
        else:
            messages = color_message(image.color, first), depth_message(image.depth_m, second)
        for publisher, message in zip(self._images, messages, strict=True):
            publisher.send(message)
        self._send_infos(header)

    def _send_infos(self, header: Header) -> None:
        for publisher, part, frame in zip(self._infos, self._parts, self._frames, strict=True):
            publisher.send(info_message(self._model, part, Header(header.stamp, frame)))


class Kept:
    """Images for the trial's file, packed when there is time."""

    def __init__(self, cameras: tuple[str, ...]):
        self.waiting: deque[tuple[str, Taken]] = deque()
        self._blobs: dict[str, bytes] = {}
        self._taken: dict[str, list[tuple[float, str]]] = {name: [] for name in cameras}

    def add(self, camera: str, image: Taken) -> None:
        """Keep an image."""
        self.waiting.append((camera, image))

    def pack(self) -> None:
        """Pack the first image that waits."""
        camera, image = self.waiting.popleft()
        files = image_files(f"{camera}_{len(self._taken[camera]):03d}", image)
        self._blobs |= files
        self._taken[camera].append((round(image.time_s, 6), next(iter(files))))

    def files(self) -> Files:
        """Return all kept images as files."""
        while self.waiting:
            self.pack()
        return self._blobs, self._taken
