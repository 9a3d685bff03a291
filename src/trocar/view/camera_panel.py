"""Images of a camera beside a scene, and what was found in them."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont, UnidentifiedImageError

from trocar.replay import CameraImage, Replay
from trocar.view.film import last_until
from trocar.view.stage import Rgb

if TYPE_CHECKING:
    from viser import GuiApi

WIDEST_PX = 840  # width of a camera's image, small enough to be sent quickly


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
        """Show the last image taken up to a tick."""
        last = last_until(self._taken_s, self._times_s[tick])
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


def decoded(image: CameraImage) -> NDArray[np.uint8] | None:
    """Return an image (h, w, 3), reduced if it is large; None if it is damaged."""
    try:
        with Image.open(io.BytesIO(image.encoded)) as file:
            picture = file.convert("RGB")
    except (UnidentifiedImageError, OSError, ValueError):
        return None
    return reduced(picture)


FOUND: Rgb = (255, 225, 40)
HALO: Rgb = (20, 20, 20)
SMALL = ImageFont.load_default(size=12)
SMALL_PX = (480, 360)
"""Images are enlarged by the largest whole factor that keeps them within this size."""


def with_outlines(color: NDArray[np.uint8], outlines_px: Mapping[str, NDArray[np.float64]]) -> NDArray[np.uint8]:
    """Return an image (h, w, 3), enlarged if it is small, with closed outlines (n, 2) in its pixels and their names.

    Outlines with unknown points (nan) are left out.
    """
    height, width = color.shape[:2]
    times = max(1, min(SMALL_PX[0] // width, SMALL_PX[1] // height))
    picture = Image.fromarray(color.repeat(times, 0).repeat(times, 1))
    pen = ImageDraw.Draw(picture)
    for name, line_px in outlines_px.items():
        if not np.isfinite(line_px).all():
            continue
        drawn = times * (np.concatenate([line_px, line_px[:1]]) + 0.5) - 0.5
        corners = [tuple(corner) for corner in drawn.tolist()]
        for colour, width in ((HALO, 4), (FOUND, 2)):
            pen.line(corners, fill=colour, width=width, joint="curve")
        left, right, middle = drawn[:, 0].min() - 4, drawn[:, 0].max() + 4, drawn[:, 1].mean()
        fits = right + pen.textlength(name, SMALL) < picture.width
        at, anchor = ((right, middle), "lm") if fits else ((left, middle), "rm")
        pen.text(at, name, FOUND, SMALL, anchor, stroke_width=2, stroke_fill=HALO)
    return np.asarray(picture)


def reduced(picture: Image.Image) -> NDArray[np.uint8]:
    """Return a picture (h, w, 3), reduced if it is large."""
    picture.thumbnail((WIDEST_PX, WIDEST_PX))
    return np.asarray(picture)
