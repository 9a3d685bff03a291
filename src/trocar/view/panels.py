"""Panels beside a scene: time line, errors of the tips, cameras, joints."""

from __future__ import annotations

import io
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont, UnidentifiedImageError

from trocar.errors import InvalidInput
from trocar.replay import CameraImage, Replay
from trocar.view.film import last_until
from trocar.view.stage import CONTACT, Rgb, arm_colours, css

if TYPE_CHECKING:
    from viser import GuiApi

KINDS = ("desired", "commanded", "measured", "true")
PRISMATIC = 2  # yaw, pitch, insertion, roll, wrist pitch, wrist yaw, jaw: ``ArmModel`` has its third joint slide
SCALE = np.where(np.arange(7) == PRISMATIC, 1e3, 180 / np.pi)  # from m and rad to mm and deg
WINDOW_S = 5.0  # before and after the present, in curves and in the close-up of the time line
POINTS = 250  # of a curve, maximum


@dataclass(frozen=True, eq=False)
class Joints:
    """Joints of one arm in degrees, the insertion in mm.

    Attributes:
        names: seven.
        times_s: (n,).
        values: (n, 7) of each available one of ``KINDS``.
        reference: the one of ``KINDS`` with which the others are compared.
    """

    names: tuple[str, ...]
    times_s: NDArray[np.float64]
    values: dict[str, NDArray[np.float64]]
    reference: str

    @staticmethod
    def of(replay: Replay, arm: str) -> Joints | None:
        """Return the joints of an arm, or None if the replay has none.

        Raises:
            TrocarError: an array has another shape than (n, 7).
        """
        given = replay.joints.get(arm, {})
        kinds = [kind for kind in KINDS if kind in given]
        if not kinds:
            return None
        shape = (len(replay.times_s), 7)
        for kind in kinds:
            if given[kind].shape != shape:
                raise InvalidInput(f"the {kind} joints", f"of '{arm}' have shape {given[kind].shape}", f"give {shape}")
        names = replay.joint_names.get(arm, tuple(f"joint {k + 1}" for k in range(7)))
        return Joints(names, replay.times_s, {kind: given[kind] * SCALE for kind in kinds}, kinds[0])

    def table(self, tick: int) -> str:
        """Return the joints at a tick in Markdown, with the last kind's error against the reference."""
        kinds = list(self.values)
        error = kinds[-1] if len(kinds) > 1 else None
        heads = ["joint", *kinds, *([f"{error} - {self.reference}"] if error else [])]
        rows = [f"| {' | '.join(heads)} |", "|:--" + "|--:" * (len(heads) - 1) + "|"]
        for k, name in enumerate(self.names):
            numbers = [f"{self.values[kind][tick, k]:.1f}" for kind in kinds]
            if error:
                numbers.append(f"**{self.values[error][tick, k] - self.values[self.reference][tick, k]:+.2f}**")
            rows.append(f"| {name.replace('_', ' ')}, {unit(k)} | {' | '.join(numbers)} |")
        return "\n".join(rows)

    def compared(self) -> tuple[str, ...]:
        """Return the kinds that are compared with the reference."""
        return tuple(kind for kind in self.values if kind != self.reference)

    def errors_near(self, tick: int, joint: int) -> tuple[NDArray[np.float64], ...]:
        """Return seconds from a tick's time (k,), and the difference (k,) of each of :meth:`compared`, deg or mm."""
        now = self.times_s[tick]
        first, last = np.searchsorted(self.times_s, [now - WINDOW_S, now + WINDOW_S])
        ticks = np.arange(first, last, max(1, (last - first) // POINTS))
        reference = self.values[self.reference][ticks, joint]
        return (self.times_s[ticks] - now, *(self.values[kind][ticks, joint] - reference for kind in self.compared()))


def unit(joint: int) -> str:
    """Return the unit in which a joint, counted from 0, is shown."""
    return "mm" if joint == PRISMATIC else "deg"


Span = tuple[str, str, float, float]
"""Arm, name, start and end in s."""

BESIDE = "padding:0 14px;line-height:1.6;"
"""Style of words that begin where pictures and text of viser's do."""
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
        """Take the spans; those of ``names`` have their colours first, in order, whether they are there or not."""
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
        top = ROW_PX * len(self.arms)
        for tick_s in MaxNLocator(10).tick_values(from_s, to_s):
            if from_s <= tick_s <= to_s:
                x = NAMES_PX + scale * (tick_s - from_s)
                pen.line((x, top, x, top + 6), fill=QUIET)
                pen.text((min(x, WIDTH_PX - 18), top + 7), f"{tick_s:g}", fill=QUIET, font=FONT, anchor="ma")
        pen.text((0, top + 7), "s", fill=QUIET, font=FONT)
        return np.asarray(picture)


class ErrorStrip:
    """A picture of how far each arm's tip was from where it was planned, over the same time as a time line."""

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
        """Return the strip: contacts and missed goals as vertical lines, the largest error of each pixel's time."""
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
    """Return a picture with a line at a share of its time, from its top down to so far above its bottom."""
    marked = picture.copy()
    x = NAMES_PX + round(min(max(share, 0.0), 1.0) * (WIDTH_PX - NAMES_PX - 1))
    marked[: len(marked) - below_px, max(0, x - 1) : x + 2] = INK
    return marked


WIDEST_PX = 840  # width of a camera's image, small enough to be sent quickly
CURVES: Mapping[str, Rgb] = {"commanded": (40, 120, 255), "measured": (214, 60, 160), "true": (95, 215, 40)}


def panels(gui: GuiApi, replay: Replay) -> list[TimeLinePanel | ErrorPanel | CameraPanel | JointsPanel]:
    """Add the panels for which the replay has data, and return them; each shows a tick of ``Replay.times_s``."""
    found: list[TimeLinePanel | ErrorPanel | CameraPanel | JointsPanel] = []
    if replay.tools:
        with gui.add_folder("Tips, driven from planned"):
            found.append(ErrorPanel(gui, replay))
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
    """How far the tips were from where they were planned, over the whole trial."""

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


class JointsPanel:
    """One joint's errors as curves, ``ahead_s`` beyond the present, all joints as a table."""

    def __init__(self, gui: GuiApi, joints: Joints, ahead_s: float = WINDOW_S) -> None:
        self._joints, self._tick = joints, 0
        if joints.compared():
            self._menu = gui.add_dropdown("joint", joints.names, initial_value=joints.names[-2])
            looks: list[Any] = [{"label": kind, "stroke": css(CURVES[kind]), "width": 2} for kind in joints.compared()]
            scales: dict[str, Any] = {"x": {"time": False, "range": (-WINDOW_S, ahead_s)}}
            data = joints.errors_near(0, len(joints.names) - 2)
            self._curves = gui.add_uplot(data, ({"label": "s from now"}, *looks), scales=scales, height=170)
            self._menu.on_update(lambda _: self._draw_curves())
        self._table = gui.add_markdown("")
        self.show(0)

    def show(self, tick: int) -> None:
        """Show a tick."""
        self._tick = tick
        self._table.content = self._joints.table(tick)
        if self._joints.compared():
            self._draw_curves()

    def renew(self, joints: Joints) -> None:
        """Take other joints, of the same kinds, and show their end."""
        self._joints = joints
        self.show(len(joints.times_s) - 1)

    def _draw_curves(self) -> None:
        joint = self._joints.names.index(self._menu.value)
        self._curves.title = f"{self._menu.value}: difference from {self._joints.reference}, {unit(joint)}"
        self._curves.data = self._joints.errors_near(self._tick, joint)


class LiveTimeLine:
    """The scripts' spans of the last seconds, up to the present, where those that have not ended are marked."""

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
        """Draw a time, with the spans that have begun and not ended."""
        from_s = max(0.0, time_s - 2 * WINDOW_S)
        while self._spans and self._spans[0][3] < from_s:
            self._spans.popleft()
        present = [(arm, name, start_s, time_s) for arm, name, start_s in begun]
        self._names |= dict.fromkeys(name for _, name, _ in begun)
        spans = sorted([*self._spans, *present], key=lambda span: span[0])  # else rows would change places
        line = TimeLine(spans, from_s, time_s, tuple(self._names))
        self._picture.visible = bool(spans)
        if spans:
            self._picture.image, self._legend.content = line.near(time_s), line.legend()
        now = ", ".join(f"<b>{escape(arm)}</b> {escape(name)}" for arm, name, _ in begun)
        self._now.content = f'<div style="{BESIDE}font-size:13px">now: {now or "no step of a script"}</div>'


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
"""An image is enlarged to whole multiples of its width and height that are no larger."""


def with_outlines(color: NDArray[np.uint8], outlines_px: Mapping[str, NDArray[np.float64]]) -> NDArray[np.uint8]:
    """Return an image (h, w, 3), enlarged if it is small, with closed lines (n, 2) of its pixels beside their names.

    A line with an unknown place is left out.
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
