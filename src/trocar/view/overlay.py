"""What is drawn over a scene: colours, labels, paths, contacts."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.replay import Contact, Replay
from trocar.view.film import Film

if TYPE_CHECKING:
    from viser import SceneApi

Rgb = tuple[int, int, int]

PLANNED: Rgb = (40, 120, 255)
DRIVEN: Rgb = (95, 215, 40)
CONTACT: Rgb = (214, 60, 160)
SKY: Rgb = (238, 240, 243)
HORIZON: Rgb = (206, 211, 217)


def css(colour: Rgb) -> str:
    """Return a colour in CSS notation."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


SPACING_M, MAX_POINTS = 1e-3, 2000  # spacing of a whole path
STEP_S = 0.05  # between two points of a stretch
THIN_PX, BOLD_PX = 1.5, 4.5
GREY: Rgb = (128, 132, 140)
GREYED = 0.35  # share of grey in thin paths


@dataclass(frozen=True)
class PathWindow:
    """The part of a path near the present that is drawn.

    Attributes:
        name: last part of its node's name.
        behind_s: time before the present.
        ahead_s: time after the present.
        leap_s: it advances in steps of this time; 0: with each frame, up to the tip itself.
        width_px: of the line; a thin one is greyer.
    """

    name: str
    behind_s: float
    ahead_s: float
    leap_s: float
    width_px: float


NEAR = PathWindow("near", 8.0, 4.0, 1.0, THIN_PX)
PLANNED_NOW = PathWindow("now", 2.0, 1.0, STEP_S, BOLD_PX)
DRIVEN_NOW = PathWindow("now", 2.0, 0.0, 0.0, BOLD_PX)


class Paths:
    """Planned and driven path of each arm's tip: nodes ``/paths/ARM KIND, now`` and ``near``, and ``all``.

    That one is hidden, since in a long trial it would cover the scene.
    """

    def __init__(self, scene: SceneApi, replay: Replay, film: Film) -> None:
        self._trails: list[Trail] = []
        self._times_s = film.times_s
        for arm, path in replay.tools.items():
            for kind, points, colour, now in (
                ("planned", path.p_world_planned_m, PLANNED, PLANNED_NOW),
                ("driven", path.p_world_driven_m, DRIVEN, DRIVEN_NOW),
            ):
                known = filled(points)
                if known is not None:
                    name = f"/paths/{arm} {kind}"
                    _add_line(scene, f"{name}, all", thinned(known), colour, THIN_PX).visible = False
                    self._trails += [Trail(scene, name, replay.times_s, known, colour, part) for part in (NEAR, now)]

    def show(self, frame: int) -> None:
        """Draw the parts near a frame in time."""
        for trail in self._trails:
            trail.show(float(self._times_s[frame]))


class Trail:
    """One stretch of one path: points every ``STEP_S``, which stay in place while the stretch advances."""

    def __init__(
        self,
        scene: SceneApi,
        name: str,
        times_s: NDArray[np.float64],
        points_m: NDArray[np.float64],
        colour: Rgb,
        part: PathWindow,
    ) -> None:
        self._times_s, self._points_m, self._part = times_s, points_m.astype(np.float32), part
        self._clock_s = np.arange(times_s[0], times_s[-1] + STEP_S, STEP_S)
        self._on_clock_m = self._points_m[self._ticks(self._clock_s)]
        self._drawn = self._stretch(float(times_s[0]))
        self._node = _add_line(scene, f"{name}, {part.name}", self._drawn, colour, part.width_px)

    def show(self, time_s: float) -> None:
        """Draw the stretch about a time, unless it is drawn already."""
        stretch = self._stretch(time_s)
        if not np.array_equal(stretch, self._drawn):
            self._drawn = stretch
            self._node.points = _segments(stretch)

    def _stretch(self, time_s: float) -> NDArray[np.float32]:
        """Return the points (k, 3), at least two."""
        leap_s = self._part.leap_s
        about_s = leap_s * np.floor(time_s / leap_s + 1e-9) if leap_s else time_s
        first, last = np.searchsorted(self._clock_s, [about_s - self._part.behind_s, about_s + self._part.ahead_s])
        points = self._on_clock_m[min(first, len(self._clock_s) - 1) : max(1, last)]
        if leap_s and len(points) > 1:
            return points
        return np.concatenate([points, self._points_m[self._ticks(np.array([time_s]))]])

    def _ticks(self, times_s: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the ticks (k,) at times (k,)."""
        return np.clip(np.searchsorted(self._times_s, times_s - 1e-9), 0, len(self._times_s) - 1)


def thinned(points_m: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return points (k, 3) of a path (n, 3) that are ``SPACING_M`` apart, or further to limit their number."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1))])
    spacing = max(SPACING_M, way[-1] / MAX_POINTS)
    _, first = np.unique(np.floor(way / spacing), return_index=True)
    return points_m[np.append(first, len(points_m) - 1)].astype(np.float32)


def filled(points_m: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return a path (n, 3) with straight lines where it is unknown (nan); None if it is unknown everywhere."""
    known = np.flatnonzero(np.isfinite(points_m).all(1))
    if not len(known):
        return None
    return np.column_stack([np.interp(np.arange(len(points_m)), known, column[known]) for column in points_m.T])


def _segments(points_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the pieces (k - 1, 2, 3) of a line."""
    return np.stack([points_m[:-1], points_m[1:]], axis=1)


def _add_line(scene: SceneApi, name: str, points_m: NDArray[np.float32], colour: Rgb, width_px: float):
    """Add a line to the scene; thin ones are greyer."""
    grey = GREYED if width_px == THIN_PX else 0.0
    rgb = np.rint((1 - grey) * np.array(colour) + grey * np.array(GREY)).astype(np.uint8)
    return scene.add_line_segments(name, _segments(points_m), rgb, thickness=width_px, thickness_units="screen")


STEP_M = 1e-3  # a label stays in place while its arm moves less than this


class ArmLabels:
    """A label over each arm's tip, so high above it, that says what the arm is doing."""

    def __init__(self, scene: SceneApi, replay: Replay, film: Film, above_m: float) -> None:
        paths = {arm: filled(path.p_world_driven_m) for arm, path in replay.tools.items()}
        self._places = {arm: p[film.ticks] + [0.0, 0.0, above_m] for arm, p in paths.items() if p is not None}
        self._texts = {arm: captions(replay, film, arm) for arm in replay.tools}
        self._labels = {
            arm: scene.add_label(
                f"/arms/{arm}", arm, position=tuple(places[0].tolist()), anchor="bottom-center", font_screen_scale=1.2
            )
            for arm, places in self._places.items()
        }
        self.show(0)

    def show(self, frame: int) -> None:
        """Put the labels over the tips at a frame, with what the arms are doing."""
        for arm, label in self._labels.items():
            place = self._places[arm][frame]
            if np.linalg.norm(place - label.position) > STEP_M:
                label.position = place
            label.text = self._texts[arm][frame]


def captions(replay: Replay, film: Film, arm: str) -> list[str]:
    """Return for each frame the arm's name and what it is doing: the name of its shortest span about that time."""
    texts = [arm] * len(film.times_s)
    spans = [span for span in replay.spans if span[0] == arm]
    for _, name, start_s, end_s in sorted(spans, key=lambda span: span[2] - span[3]):  # the longest first
        first, last = np.searchsorted(film.times_s, [start_s, end_s])
        texts[first:last] = [f"{arm}: {name}"] * (last - first)
    return texts


MIN_S = 0.5  # a shorter touch is shown for this long, to be visible at all


class Contacts:
    """As many balls of a radius as there are simultaneous touches, hidden at first."""

    def __init__(self, scene: SceneApi, replay: Replay, film: Film, radius_m: float) -> None:
        self._rows = rows(replay.contacts)
        self._times_s = film.times_s
        self._shown: list[Contact | None] = [None] * len(self._rows)
        look = {"color": CONTACT, "opacity": 0.85, "cast_shadow": False, "visible": False}
        self._balls = [scene.add_icosphere(f"/contacts/{k}", radius_m, **look) for k in range(len(self._rows))]
        self._labels = [
            scene.add_label(f"/contacts/{k}/label", "", position=(0.0, 0.0, 1.5 * radius_m), anchor="bottom-center")
            for k in range(len(self._rows))
        ]

    def show(self, frame: int) -> None:
        """Show the touches of a frame."""
        time_s = float(self._times_s[frame])
        for k, row in enumerate(self._rows):
            now = next((touch for touch in row if touch.time_s <= time_s < shown_until(touch)), None)
            if now is not self._shown[k]:
                self._shown[k] = now
                if now is not None:
                    self._balls[k].position = now.p_world_m
                    self._labels[k].text = f"{' - '.join(now.between)}, {now.force_n:.1f} N"
                self._balls[k].visible = now is not None


def shown_until(touch: Contact) -> float:
    """Return the time until which a touch is shown."""
    return max(touch.end_s, touch.time_s + MIN_S)


def rows(contacts: tuple[Contact, ...]) -> list[list[Contact]]:
    """Return the contacts in as few rows as possible without simultaneous contacts in a row."""
    found: list[list[Contact]] = []
    for touch in sorted(contacts, key=lambda touch: touch.time_s):
        free = next((row for row in found if shown_until(row[-1]) <= touch.time_s), None)
        if free is None:
            found.append([touch])
        else:
            free.append(touch)
    return found


NOTICE = "Simulated. For research, not for use on patients."

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob: data:; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src data: blob:; worker-src blob: data:; font-src data:"
)
"""Security policy: the browser lets the page load only its own content."""

STYLE = """
#trocar { position: fixed; inset: 0 auto auto 0; z-index: 1; margin: 12px; padding: 8px 14px;
  max-width: calc(100vw - 90px); border-radius: 6px; background: rgb(255 255 255 / 82%); pointer-events: none;
  font: 13px/1.5 system-ui, "Segoe UI", Roboto, Helvetica, Arial, sans-serif; color: #22262b; }
#trocar h1 { font-size: 16px; font-weight: 600; margin: 0; }
#trocar ul { list-style: none; margin: 4px 0 0; padding: 0; display: flex; flex-wrap: wrap; gap: 0 16px; }
#trocar i { display: inline-block; vertical-align: middle; margin-right: 6px; }
#trocar i.line { width: 22px; height: 0; border-top: 4px solid; }
#trocar i.ball { width: 11px; height: 11px; border-radius: 50%; }
#trocar p { margin: 2px 0 0; font-size: 12px; color: #59606a; }
.mantine-Notifications-root { margin-top: 84px; }
"""


def with_overlay(page: str, replay: Replay, film: Film) -> str:
    """Return viser's page with the replay's title and legend over it, and without network access."""
    entries = [
        *([_entry("line", PLANNED, "tip, planned"), _entry("line", DRIVEN, "tip, driven")] if replay.tools else []),
        *([_entry("ball", CONTACT, "contact")] if replay.contacts else []),
    ]
    title = escape(replay.title)
    block = (
        f'<div id="trocar"><h1>{title}</h1><ul>{"".join(entries)}</ul>'
        f"<p>{film.rate_hz:g} frames per second. {NOTICE}</p></div>"
    )
    page = page.replace("<title>Viser</title>", f"<title>{title}</title>", 1)
    page = page.replace("<head>", f'<head><meta http-equiv="Content-Security-Policy" content="{POLICY}">', 1)
    page = page.replace("</head>", f"<style>{STYLE}</style></head>", 1)
    return page.replace("</body>", f"{block}</body>", 1)


def _entry(kind: str, colour: Rgb, name: str) -> str:
    where = "border-color" if kind == "line" else "background"
    return f'<li><i class="{kind}" style="{where}: {css(colour)}"></i>{name}</li>'
