"""Spans of the arms' scripts as a picture: a row per arm, a bar per span, a line at the present."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from trocar.view.palette import SPANS, Rgb, css

Span = tuple[str, str, float, float]
"""Arm, name, start and end in s."""

WIDTH_PX, ROW_PX, AXIS_PX, NAMES_PX = 840, 40, 34, 90
INK: Rgb = (34, 38, 43)
QUIET: Rgb = (107, 112, 120)
PAPER: Rgb = (255, 255, 255)
FONT = ImageFont.load_default(size=20)
NEAR_S = 5.0
"""Time before and after the present in the close-up."""


class TimeLine:
    """Pictures of spans.

    Attributes:
        arms: one row each.
        colours: of the spans, by name.
    """

    def __init__(self, spans: Sequence[Span], start_s: float, end_s: float) -> None:
        """Draw the whole trial once.

        Args:
            spans: of all arms.
            start_s: of the trial.
            end_s: of the trial.
        """
        self._spans, self._start_s = spans, start_s
        self._end_s = max(end_s, start_s + 1e-3)
        self.arms = tuple(dict.fromkeys(arm for arm, *_ in spans))
        names = dict.fromkeys(name for _, name, *_ in spans)
        self.colours = {name: SPANS[k % len(SPANS)] for k, name in enumerate(names)}
        self._all = self._drawn(self._start_s, self._end_s)

    def whole(self, time_s: float) -> NDArray[np.uint8]:
        """Return the whole trial (h, w, 3) with a line at a time."""
        return _marked(self._all, (time_s - self._start_s) / (self._end_s - self._start_s))

    def near(self, time_s: float) -> NDArray[np.uint8]:
        """Return the spans near a time (h, w, 3), within the trial, with a line at it."""
        length = min(2 * NEAR_S, self._end_s - self._start_s)
        start = min(max(time_s - length / 2, self._start_s), self._end_s - length)
        return _marked(self._drawn(start, start + length), (time_s - start) / length)

    def legend(self) -> str:
        """Return names and colours of the spans as HTML."""
        chip = '<span style="display:inline-block;width:10px;height:10px;margin:0 4px 0 0;background:{}"></span>{}'
        entries = (chip.format(css(colour), escape(name)) for name, colour in self.colours.items())
        return f'<div style="font-size:12px;line-height:1.6">{" &ensp; ".join(entries)}</div>'

    def _drawn(self, from_s: float, to_s: float) -> NDArray[np.uint8]:
        """Return a stretch of time without a line."""
        picture = Image.new("RGB", (WIDTH_PX, ROW_PX * len(self.arms) + AXIS_PX), PAPER)
        pen = ImageDraw.Draw(picture)
        scale = (WIDTH_PX - NAMES_PX) / (to_s - from_s)
        for arm, name, start_s, end_s in self._spans:
            if end_s <= from_s or start_s >= to_s:
                continue
            left = NAMES_PX + scale * (max(start_s, from_s) - from_s)
            right = NAMES_PX + scale * (min(end_s, to_s) - from_s)
            top = ROW_PX * self.arms.index(arm) + 4
            pen.rectangle((left, top, max(left + 1, right - 1), top + ROW_PX - 8), fill=self.colours[name])
            if pen.textlength(name, font=FONT) < right - left - 8:
                pen.text((left + 5, top + 4), name, fill=INK, font=FONT)
        for row, arm in enumerate(self.arms):
            pen.text((0, ROW_PX * row + 8), arm, fill=INK, font=FONT)
        _draw_axis(pen, from_s, to_s, ROW_PX * len(self.arms))
        return np.asarray(picture)


def _draw_axis(pen: ImageDraw.ImageDraw, from_s: float, to_s: float, top: int) -> None:
    """Draw seconds below the rows."""
    step = nice_step(to_s - from_s)
    scale = (WIDTH_PX - NAMES_PX) / (to_s - from_s)
    for k in range(math.ceil(from_s / step), math.floor(to_s / step) + 1):
        x = NAMES_PX + scale * (k * step - from_s)
        pen.line((x, top, x, top + 6), fill=QUIET)
        pen.text((min(x, WIDTH_PX - 18), top + 7), f"{k * step:g}", fill=QUIET, font=FONT, anchor="ma")
    pen.text((0, top + 7), "s", fill=QUIET, font=FONT)


def nice_step(length_s: float) -> float:
    """Return a round number of seconds that fits five to twelve times into this length."""
    rough = length_s / 10
    unit = 10.0 ** math.floor(math.log10(rough))
    return unit * next(factor for factor in (1, 2, 5, 10) if factor * unit >= rough * 0.9)


def _marked(picture: NDArray[np.uint8], share: float) -> NDArray[np.uint8]:
    """Return a picture with a line at a share of its time."""
    marked = picture.copy()
    x = NAMES_PX + round(min(max(share, 0.0), 1.0) * (WIDTH_PX - NAMES_PX - 1))
    marked[:-AXIS_PX, max(0, x - 1) : x + 2] = INK
    return marked
