"""Checks of a camera that publishes as ROS cameras do."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trocar.crtk.convert import seconds
from trocar.crtk.heard_arm import Finding
from trocar.crtk.images import lens_of
from trocar.crtk.listening import Heard, Message, shown_by
from trocar.crtk.messages import CameraInfo, Image, ros_name
from trocar.lab.station import Station
from trocar.lab.topics import Topics

FOCAL_SHARE, CENTRE_PX = 0.01, 3.0
"""A new calibration changes a lens by no more than this."""
CLOCK_S, LATE_S = 0.02, 1.0


@dataclass
class CameraHeard:
    """What was heard of one camera.

    Attributes:
        camera: name.
        station: of the camera.
        topics: of the station.
        heard: everything that was heard.
    """

    camera: str
    station: Station
    topics: Topics
    heard: Heard

    @cached_property
    def messages(self) -> dict[str, list[Message]]:
        """Return the messages that came, by topic."""
        return {topic: list(self.heard.messages[topic]) for topic in shown_by(self.camera, self.station, self.topics)}

    @property
    def images(self) -> dict[str, list[Message]]:
        """Return the images that came, by topic."""
        return {
            topic: messages
            for topic, messages in self.messages.items()
            if messages and isinstance(messages[0][1], Image)
        }


def topics(about: CameraHeard) -> Finding:
    """Judge whether somebody publishes each topic, with the right type."""
    there = {one.topic: one.kind for one in about.heard.endpoints if one.publishes}
    wanted = shown_by(about.camera, about.station, about.topics)
    missing = [topic for topic in wanted if topic not in there]
    if missing:
        remedy = "check that the camera's driver runs, and its namespace in [crtk.cameras]"
        return Finding(False, f"no {', '.join(missing)}", remedy)
    right = {topic: ros_name(one.kind) for topic, one in wanted.items()}
    wrong = [topic for topic, kind in right.items() if there[topic] not in ("", kind)]
    if wrong:
        return Finding(False, f"{wrong[0]} is {there[wrong[0]]}, not {right[wrong[0]]}", "publish raw images")
    return Finding(True, f"{len(wanted)} of {len(wanted)}")


def lens(about: CameraHeard) -> Finding:
    """Judge whether the published lens is the station's."""
    come = [one for messages in about.messages.values() for _, one in messages if isinstance(one, CameraInfo)]
    if not come:
        return Finding(None, "no camera_info came")
    known, told = lens_of(about.station.cameras[about.camera].model_registered), come[-1]
    fx, _, cx, _, fy, cy = told.k[:6]
    found = f"{told.width} x {told.height} px, focal {fx:.1f} {fy:.1f}, centre {cx:.1f} {cy:.1f}"
    size = (told.width, told.height) == (known.width, known.height)
    focal = max(abs(fx / known.fx - 1), abs(fy / known.fy - 1)) <= FOCAL_SHARE
    centre = max(abs(cx - known.cx), abs(cy - known.cy)) <= CENTRE_PX
    wanted = (
        f"{known.width} x {known.height} px, focal {known.fx:.1f} {known.fy:.1f}, centre {known.cx:.1f} {known.cy:.1f}"
    )
    remedy = f"the station's file says {wanted}: correct it, or calibrate the camera and its driver again"
    return Finding(size and focal and centre, found, remedy)


def images(about: CameraHeard) -> Finding:
    """Judge size, stamps and clock of the images; a camera may send none until it is triggered."""
    if not about.images:
        return Finding(None, "none came: it may wait for its trigger")
    known = lens_of(about.station.cameras[about.camera].model)
    for topic, messages in about.images.items():
        one = messages[-1][1]
        if (one.width, one.height) != (known.width, known.height):
            remedy = f"the station's file says {known.width} x {known.height}: correct it, or the camera's settings"
            return Finding(False, f"{topic} has {one.width} x {one.height} px", remedy)
        age_s = float(np.median([at_s - seconds(message.header.stamp) for at_s, message in messages]))
        if not -CLOCK_S <= age_s <= LATE_S:
            found = f"those of {topic} come {abs(age_s):.2f} s {'after' if age_s >= 0 else 'before'} their stamps"
            return Finding(False, found, "let both machines' clocks agree: run chrony (NTP) on both")
    return Finding(True, f"{sum(map(len, about.images.values()))} came")


CAMERA = {
    "topics": ("all are published", topics),
    "lens": ("the station's", lens),
    "images": (f"the station's size, {LATE_S:g} s after their stamps at most", images),
}
"""Checks by name, in order: the expected result in words, and the test."""
