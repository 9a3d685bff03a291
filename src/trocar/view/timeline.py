"""Time lines beside a scene: the spans of scripts, and the tips' distances from their planned positions."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from trocar.replay import Replay
from trocar.view.stage import CONTACT, Rgb, arm_colours, css

if TYPE_CHECKING:
    from viser import GuiApi

WINDOW_S = 5.0  # before and after the present, in curves and in the close-up of the time line
Span = tuple[str, str, float, float]
"""Arm, name, start and end in s."""
BESIDE = "padding:0 14px;line-height:1.6;"
"""Style that aligns text with viser's pictures and text."""
WIDTH_PX, ROW_PX, AXIS_PX, NAMES_PX = 840, 40, 34, 90
STRIP_PX = 84
LEAST_MM = 2.0  # upper end of a strip's scale, if no error is larger
INK: Rgb = (34, 38, 43)
QUIET: Rgb = (107, 112, 120)
PAPER: Rgb = (255, 255, 255)
FAILED: Rgb = (190, 40, 40)
SPANS = [tuple(rgb) for rgb in np.rint(255 * np.array(mpl.colormaps["Set3"].colors)).astype(int).tolist()]  # type: ignore[attr-defined]
FONT = ImageFont.load_default(size=20)


class TimeLine:
    """Pictures of all arms' spans in a trial that starts and ends at these times.

    Attributes:
        arms: one row each.
        colours: of the spans, by name.
    """

    def __init__(self, spans: Sequence[Span], start_s: float, end_s: float, names: Sequence[str] = ()) -> None:
        """Take the spans; ``names`` get the first colours, in order, even if no span has these names."""
        self._spans, self._start_s = spans, start_s
        self._end_s = max(end_s, start_s + 1e-3)
        self.arms = tuple(dict.fromkeys(arm for arm, *_ in spans))
        known = dict.fromkeys([*names, *(name for _, name, *_ in spans)])
        self.colours = {name: SPANS[k % len(SPANS)] for k, name in enumerate(known)}

    @cached_property
    def _all(self) -> NDArray[np.uint8]:
        return self._drawn(self._start_s, self._end_s)

    def whole(self, time_s: float) -> NDArray[np.uint8]:
        """Return the whole trial (h, w, 3) with a line at a time."""
        return _marked(self._all, (time_s - self._start_s) / (self._end_s - self._start_s))

    def near(self, time_s: float) -> NDArray[np.uint8]:
        """Return the spans near a time (h, w, 3), within the trial, with a line at it."""
        length = min(2 * WINDOW_S, self._end_s - self._start_s)
        start = min(max(time_s - length / 2, self._start_s), self._end_s - length)
        return _marked(self._drawn(start, start + length), (time_s - start) / length)

    def legend(self) -> str:
        """Return names and colours of the spans as HTML."""
        box = '<span style="display:inline-block;width:10px;height:10px;margin:0 4px 0 0;background:{}"></span>{}'
        chip = f'<span style="white-space:nowrap">{box}</span>'
        entries = (chip.format(css(colour), escape(name)) for name, colour in self.colours.items())
        return f'<div style="{BESIDE}font-size:12px">{" &ensp; ".join(entries)}</div>'

    def _drawn(self, from_s: float, to_s: float) -> NDArray[np.uint8]:
        """Return the picture of a stretch of time, without the line of the present."""
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
        top = ROW_PX * len(self.arms)
        for tick_s in MaxNLocator(10).tick_values(from_s, to_s):
            if from_s <= tick_s <= to_s:
                x = NAMES_PX + scale * (tick_s - from_s)
                pen.line((x, top, x, top + 6), fill=QUIET)
                pen.text((min(x, WIDTH_PX - 18), top + 7), f"{tick_s:g}", fill=QUIET, font=FONT, anchor="ma")
        pen.text((0, top + 7), "s", fill=QUIET, font=FONT)
        return np.asarray(picture)


class ErrorStrip:
    """A picture of each tip's distance from its planned position, over the same time as a time line."""

    def __init__(self, replay: Replay) -> None:
        self._start_s = float(replay.times_s[0])
        self._length_s = max(float(replay.times_s[-1]) - self._start_s, 1e-3)
        self.errors_mm = {
            arm: 1e3 * np.linalg.norm(path.p_world_driven_m - path.p_world_planned_m, axis=1)
            for arm, path in replay.tools.items()
        }
        known = np.concatenate([*self.errors_mm.values(), [LEAST_MM]])
        self.top_mm = float(np.nanmax(known))
        self._all = self._drawn(replay)

    def at(self, time_s: float) -> NDArray[np.uint8]:
        """Return the strip (h, w, 3) with a line at a time."""
        return _marked(self._all, (time_s - self._start_s) / self._length_s, 0)

    def said(self, tick: int) -> str:
        """Return the errors at a tick in words."""
        return ", ".join(f"{arm} {error[tick]:.1f} mm" for arm, error in self.errors_mm.items())

    def _drawn(self, replay: Replay) -> NDArray[np.uint8]:
        """Return the strip: contacts and missed goals as vertical lines, and each pixel column's largest error."""
        picture = Image.new("RGB", (WIDTH_PX, STRIP_PX), PAPER)
        pen = ImageDraw.Draw(picture)
        pen.text((0, 2), f"{self.top_mm:.1f} mm", fill=QUIET, font=FONT)
        pen.text((0, STRIP_PX - 24), "0", fill=QUIET, font=FONT)
        pen.line((NAMES_PX, STRIP_PX - 2, WIDTH_PX, STRIP_PX - 2), fill=QUIET)
        width = WIDTH_PX - NAMES_PX
        for times_s, colour in (
            ([touch.time_s for touch in replay.contacts], CONTACT),
            ([goal.end_s for goal in replay.goals if goal.failed], FAILED),
        ):
            for time_s in times_s:
                x = NAMES_PX + (time_s - self._start_s) / self._length_s * width
                pen.line((x, 0, x, STRIP_PX), fill=colour, width=3)
        column = np.clip(((replay.times_s - self._start_s) / self._length_s * width).astype(int), 0, width - 1)
        for arm, colour in arm_colours(replay).items():
            largest = np.full(width, np.nan)
            np.fmax.at(largest, column, self.errors_mm[arm])
            height = (STRIP_PX - 4) * (1 - largest / self.top_mm)
            points = [(NAMES_PX + x, float(y) + 1) for x, y in enumerate(height) if np.isfinite(y)]
            pen.line(points, fill=colour, width=3)
        return np.asarray(picture)


def _marked(picture: NDArray[np.uint8], share: float, below_px: int = AXIS_PX) -> NDArray[np.uint8]:
    """Return a picture with a vertical line at a share of its time, from its top to ``below_px`` above its bottom."""
    marked = picture.copy()
    x = NAMES_PX + round(min(max(share, 0.0), 1.0) * (WIDTH_PX - NAMES_PX - 1))
    marked[: len(marked) - below_px, max(0, x - 1) : x + 2] = INK
    return marked


class TimeLinePanel:
    """The scripts' spans: the whole trial, and a close-up."""

    def __init__(self, gui: GuiApi, replay: Replay) -> None:
        self._times_s = replay.times_s
        start = float(replay.times_s[0])
        self._line = TimeLine(replay.spans, start, float(replay.times_s[-1]))
        self._whole = gui.add_image(self._line.whole(start), format="png")
        self._near = gui.add_image(self._line.near(start), format="png")
        gui.add_html(self._line.legend())

    def show(self, tick: int) -> None:
        """Draw the line of the present at a tick."""
        now = float(self._times_s[tick])
        self._whole.image, self._near.image = self._line.whole(now), self._line.near(now)


class ErrorPanel:
    """The tips' distances from their planned positions, over the whole trial."""

    def __init__(self, gui: GuiApi, replay: Replay) -> None:
        self._times_s, self._strip = replay.times_s, ErrorStrip(replay)
        self._said = gui.add_markdown(self._strip.said(0))
        self._picture = gui.add_image(self._strip.at(float(replay.times_s[0])), format="png")
        chip = '<span style="color:{}">&#9474;</span> {}'
        troubles = chip.format(css(CONTACT), "contact"), chip.format(css(FAILED), "missed goal")
        gui.add_html(f'<div style="{BESIDE}font-size:12px">{" &ensp; ".join(troubles)}</div>')

    def show(self, tick: int) -> None:
        """Show a tick."""
        self._said.content = self._strip.said(tick)
        self._picture.image = self._strip.at(float(self._times_s[tick]))


class LiveTimeLine:
    """The scripts' spans of the last seconds up to the present, including those that have not ended."""

    def __init__(self, gui: GuiApi) -> None:
        self._spans: deque[Span] = deque()
        self._names: dict[str, None] = {}
        self._now = gui.add_html("")
        self._picture = gui.add_image(np.full((ROW_PX + AXIS_PX, WIDTH_PX, 3), 255, np.uint8), format="png")
        self._legend = gui.add_html("")

    def add(self, ended: Sequence[Span]) -> None:
        """Take spans that have ended."""
        self._spans.extend(ended)
        self._names |= dict.fromkeys(name for _, name, *_ in ended)

    def clear(self) -> None:
        """Forget all spans: another trial begins."""
        self._spans.clear()

    def show(self, time_s: float, begun: Sequence[tuple[str, str, float]]) -> None:
        """Draw the time line up to a time; ``begun``: spans that have not ended."""
        from_s = max(0.0, time_s - 2 * WINDOW_S)
        while self._spans and self._spans[0][3] < from_s:
            self._spans.popleft()
        present = [(arm, name, start_s, time_s) for arm, name, start_s in begun]
        self._names |= dict.fromkeys(name for _, name, _ in begun)
        spans = sorted([*self._spans, *present], key=lambda span: span[0])  # else rows would swap
        line = TimeLine(spans, from_s, time_s, tuple(self._names))
        self._picture.visible = bool(spans)
        if spans:
            self._picture.image, self._legend.content = line.near(time_s), line.legend()
        now = ", ".join(f"<b>{escape(arm)}</b> {escape(name)}" for arm, name, _ in begun)
        self._now.content = f'<div style="{BESIDE}font-size:13px">now: {now or "no step of a script"}</div>'
