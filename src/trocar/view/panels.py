"""Panels beside a replay in the browser: time line, camera, joints. Each shows one moment."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from trocar.replay import CameraImage, Replay
from trocar.view.joints import WINDOW_S, Joints, unit
from trocar.view.palette import CONTACT, DRIVEN, PLANNED, css
from trocar.view.timeline import TimeLine

if TYPE_CHECKING:
    from viser import GuiApi

WIDEST_PX = 840  # width of a camera's image, small enough to be sent quickly
CURVES = (PLANNED, CONTACT, DRIVEN)


class Panel(Protocol):
    """Something that shows one moment of a replay."""

    def show(self, tick: int) -> None:
        """Show a tick of ``Replay.times_s``."""
        ...


def panels(gui: GuiApi, replay: Replay) -> list[Panel]:
    """Add the panels for which the replay has data, and return them."""
    found: list[Panel] = []
    if replay.spans:
        with gui.add_folder("Time line"):
            found.append(TimeLinePanel(gui, replay))
    for camera in dict.fromkeys(image.camera for image in replay.images):
        with gui.add_folder(f"Camera: {camera}"):
            found.append(CameraPanel(gui, replay, camera))
    joints = {arm: Joints.of(replay, arm) for arm in replay.joints}
    if any(joints.values()):
        with gui.add_folder("Joints"):
            tabs = gui.add_tab_group()
            for arm, values in joints.items():
                if values is not None:
                    with tabs.add_tab(arm):
                        found.append(JointsPanel(gui, values))
    return found


class TimeLinePanel:
    """The scripts' spans: the whole trial, and a close-up."""

    def __init__(self, gui: GuiApi, replay: Replay) -> None:
        self._times_s = replay.times_s
        self._line = TimeLine(replay.spans, float(replay.times_s[0]), float(replay.times_s[-1]))
        start = float(replay.times_s[0])
        self._whole = gui.add_image(self._line.whole(start), format="png")
        self._near = gui.add_image(self._line.near(start), format="png")
        gui.add_html(self._line.legend())

    def show(self, tick: int) -> None:
        """Draw the line of the present at a tick."""
        now = float(self._times_s[tick])
        self._whole.image, self._near.image = self._line.whole(now), self._line.near(now)


class CameraPanel:
    """The latest image of a camera."""

    def __init__(self, gui: GuiApi, replay: Replay, camera: str) -> None:
        self._times_s = replay.times_s
        self._images = sorted((i for i in replay.images if i.camera == camera), key=lambda image: image.time_s)
        self._taken_s = np.array([image.time_s for image in self._images])
        self._shown: int | None = None
        self._said = gui.add_markdown("")
        self._picture = gui.add_image(np.full((9, 16, 3), 235, np.uint8), format="jpeg", visible=False)
        self.show(0)

    def show(self, tick: int) -> None:
        """Show the last image that was taken until a tick."""
        last = int(np.searchsorted(self._taken_s, self._times_s[tick] + 1e-9, side="right")) - 1
        if last == self._shown:
            return
        self._shown = last
        self._picture.visible = last >= 0
        if last < 0:
            self._said.content = f"takes its first image at {self._taken_s[0]:.2f} s"
            return
        image = decoded(self._images[last])
        self._said.content = f"taken at {self._taken_s[last]:.2f} s" + ("" if image is not None else ", unreadable")
        self._picture.visible = image is not None
        if image is not None:
            self._picture.image = image


class JointsPanel:
    """One joint's errors as curves, all joints as a table."""

    def __init__(self, gui: GuiApi, joints: Joints) -> None:
        self._joints, self._tick = joints, 0
        if joints.compared():
            self._menu = gui.add_dropdown("joint", joints.names, initial_value=joints.names[-2])
            self._curves = gui.add_uplot(
                joints.errors_near(0, len(joints.names) - 2),
                (
                    {"label": "s from now"},
                    *(
                        {"label": kind, "stroke": css(colour), "width": 2}
                        for kind, colour in zip(joints.compared(), CURVES, strict=False)
                    ),
                ),
                scales={"x": {"time": False, "range": (-WINDOW_S, WINDOW_S)}},
                height=170,
            )
            self._menu.on_update(lambda _: self._draw_curves())
        self._table = gui.add_markdown("")
        self.show(0)

    def show(self, tick: int) -> None:
        """Show a tick."""
        self._tick = tick
        self._table.content = self._joints.table(tick)
        if self._joints.compared():
            self._draw_curves()

    def _draw_curves(self) -> None:
        joint = self._joints.names.index(self._menu.value)
        self._curves.title = f"{self._menu.value}: difference from {self._joints.reference}, {unit(joint)}"
        self._curves.data = self._joints.errors_near(self._tick, joint)


def decoded(image: CameraImage) -> NDArray[np.uint8] | None:
    """Return an image (h, w, 3), reduced if it is large; None if it is damaged."""
    try:
        with Image.open(io.BytesIO(image.encoded)) as file:
            picture = file.convert("RGB")
    except (UnidentifiedImageError, OSError, ValueError):
        return None
    picture.thumbnail((WIDEST_PX, WIDEST_PX))
    return np.asarray(picture)
