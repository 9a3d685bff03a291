"""A camera that publishes its images as ROS cameras do, behind the ``Camera`` protocol."""

from __future__ import annotations

import time
from collections import deque
from enum import Enum

import trio

from trocar.crtk.bus import open_bus
from trocar.crtk.convert import seconds
from trocar.crtk.images import color_of, cut_out, depth_of, lens_of, parts_of
from trocar.crtk.messages import CameraInfo, Empty, Image
from trocar.errors import InvalidInput, TrocarError
from trocar.lab.topics import Topics
from trocar.perception.image import CameraModel, RgbdImage, StereoImage, StereoRig, StereoWindow, Window, read_out
from trocar.perception.image import Image as Taken

CONNECT_S = 5.0
ANSWER_S = 5.0
"""An image must arrive within this time of its request."""
POLL_S = 0.002
AHEAD_S = 0.05
"""A stamp may be this far in the future: some drivers stamp the end of an exposure that has begun."""
KEPT = 3
"""Number of images that may wait to be taken; one of full size has nine megabytes."""


class ImageFault(Enum):
    """What is wrong with a camera, as a sentence."""

    SILENT = "sent no image"
    OLD = "sent images whose stamps are older than the request"
    HALF = "sent images of which no two belong together"
    AHEAD = "sent an image with a stamp in the future, so that nobody knows when it was exposed"


class NoImage(TrocarError):
    """A camera gave no valid image in time.

    Attributes:
        camera: name.
        fault: what went wrong.
    """

    def __init__(self, camera: str, fault: ImageFault, detail: str, remedy: str):
        self.camera, self.fault = camera, fault
        super().__init__(f"camera {camera!r} {fault.value} ({detail}); {remedy}")


class CrtkCamera:
    """One camera: asks for an image on its topic ``trigger``, and waits for both of its parts.

    A camera that runs freely ignores the request: its first image that was exposed after the request is the answer. So
    the clocks of both machines must agree better than a frame's time (NTP or PTP).

    Args:
        name: of the camera.
        model: its lens or lenses, as registered.
        topics: where it is found: ``color/image_raw`` and ``depth/image_raw`` (in the colours' pixels), or
            ``left/image_raw`` and ``right/image_raw``.

    Raises:
        InvalidInput: it publishes no ``camera_info``, or one with another image size.
    """

    def __init__(self, name: str, model: CameraModel, topics: Topics):
        self._name, self._topic = name, topics.of_camera(name)
        self.now_s = time.monotonic  # until it belongs to a cell, whose clock counts then
        self.model, self.taken = model, list[Taken]()
        bus, parts = open_bus(topics), parts_of(model)
        self._parts = [bus.subscriber(f"{self._topic}/{part}/image_raw", Image, kept=KEPT) for part in parts]
        self._came = tuple(deque[Image](maxlen=KEPT) for _ in self._parts)
        self._trigger = bus.publisher(f"{self._topic}/trigger", Empty)
        info = bus.subscriber(f"{self._topic}/{parts[0]}/camera_info", CameraInfo, latched=True)
        deadline_s = time.monotonic() + CONNECT_S
        while not info.take() and time.monotonic() < deadline_s:
            time.sleep(0.01)
        self._check(info.last, f"{self._topic}/{parts[0]}/camera_info")

    def _check(self, info: CameraInfo | None, topic: str) -> None:
        if info is None:
            problem, remedy = f"publishes no {topic} within {CONNECT_S:g} s", "check that it runs, and its namespace"
            raise InvalidInput(f"camera {self._name!r}", problem, remedy)
        lens = lens_of(self.model)
        if (info.width, info.height) != (lens.width, lens.height):
            problem = (
                f"publishes {info.width} x {info.height} pixels, and the station says {lens.width} x {lens.height}"
            )
            raise InvalidInput(
                f"camera {self._name!r}", problem, "correct the station's file, or the camera's settings"
            )

    async def capture(self, window: Window | StereoWindow | None = None) -> Taken:
        """Ask for an image and return it, or a window of it, which is cut out here.

        Raises:
            NoImage: no valid image came in time.
            InvalidInput: the window leaves the image, or is of another kind of camera.
        """
        read_out(self.model, window)  # refuses a wrong window before an image is requested
        asked_s = time.time()
        self._trigger.send(Empty())
        first, second = await self._answer(asked_s)
        image = self._image(first, second)
        if window is None:
            self.taken.append(image)
            return image
        return cut_out(image, window)

    async def _answer(self, asked_s: float) -> tuple[Image, Image]:
        """Return both parts of the first image exposed after ``asked_s``, a time of this machine's clock."""
        deadline_s = time.monotonic() + ANSWER_S
        while time.monotonic() < deadline_s:
            for came, part in zip(self._came, self._parts, strict=True):
                came.extend(part.take())
            first, second = ({seconds(message.header.stamp): message for message in came} for came in self._came)
            ahead_s = max([*first, *second], default=0.0) - time.time()
            if ahead_s > AHEAD_S:
                where = f"{self._topic}, {ahead_s:.3f} s ahead, at most {AHEAD_S:g}"
                raise NoImage(self._name, ImageFault.AHEAD, where, "let both machines' clocks agree (NTP or PTP)")
            answers = [stamp_s for stamp_s in first if stamp_s >= asked_s and stamp_s in second]
            if answers:
                return first[min(answers)], second[min(answers)]
            await trio.sleep(POLL_S)
        where = f"{self._topic}, in {ANSWER_S:g} s"
        stamps_s = [seconds(message.header.stamp) for came in self._came for message in came]
        if not stamps_s:
            remedy = "check that it runs, and that it exposes an image on its topic 'trigger', or runs freely"
            raise NoImage(self._name, ImageFault.SILENT, where, remedy)
        if max(stamps_s) < asked_s:
            remedy = "look whether it hears its topic 'trigger', and let both machines' clocks agree (NTP)"
            raise NoImage(self._name, ImageFault.OLD, where, remedy)
        raise NoImage(self._name, ImageFault.HALF, where, "both topics of an image need the same stamp")

    def _image(self, first: Image, second: Image) -> Taken:
        time_s, item = self.now_s() - (time.time() - seconds(first.header.stamp)), f"the image of camera {self._name!r}"
        if isinstance(self.model, StereoRig):
            return StereoImage(color_of(first, item), color_of(second, item), self.model, time_s)
        return RgbdImage(color_of(first, item), depth_of(second, item), self.model, time_s)
