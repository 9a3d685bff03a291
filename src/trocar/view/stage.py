"""The stage: a scene's bodies at their poses, light, and what is drawn over them: paths, contacts, labels."""

from __future__ import annotations

import math
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.replay import Contact, Replay
from trocar.view.bodies import Bodies
from trocar.view.film import Film
from trocar.view.framing import frame_windows, look_from
from trocar.view.surroundings import add_ports, lay_table
from trocar.view.viewpoint import ASPECT, LABEL, ROW, CameraView, viewpoint

if TYPE_CHECKING:
    from viser import SceneApi, ViserServer


Rgb = tuple[int, int, int]

ARMS: tuple[Rgb, ...] = ((30, 105, 255), (110, 225, 50), (60, 62, 70))
"""Colours of arms, in order; they also differ in brightness, for colour-blind readers."""
CONTACT: Rgb = (214, 60, 160)


def css(colour: Rgb) -> str:
    """Return a colour in CSS notation."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def arm_colours(replay: Replay) -> dict[str, Rgb]:
    """Return the colour of each arm."""
    return dict(zip(replay.tools, cycle(ARMS), strict=False))


SPACING_M, MAX_POINTS = 1e-3, 2000  # spacing of a whole path
DASH_M = 2e-3  # length of a dash, and of the gap behind it
STEP_S = 0.05  # time between two points of a path
NOW_S, LEAP_S = 2.0, 1.0  # the last part of a driven path is bold; the part before it advances in steps
THIN_PX, BOLD_PX = 2.0, 4.5


class Paths:
    """Path of each arm's tip on its present goal, in the arm's colour: nodes ``/paths/ARM planned`` and so on.

    The planned path is dashed. The driven path is solid: ``driven`` from the start of the goal, and ``driven, now`` for
    the last two seconds up to the tip. Whole paths (``all``) are hidden: in a long trial they would cover the scene.
    """

    def __init__(self, scene: SceneApi, replay: Replay, film: Film) -> None:
        self._times_s, self._trails, self._whole = film.times_s, [], []
        for arm, colour in arm_colours(replay).items():
            path, stretches = replay.tools[arm], stretches_of(replay, arm)
            for kind, points, trail in (
                ("planned", path.p_world_planned_m, PlannedTrail),
                ("driven", path.p_world_driven_m, DrivenTrail),
            ):
                known = filled(points)
                if known is not None:
                    name = f"/paths/{arm} {kind}"
                    pieces = dashes(known) if trail is PlannedTrail else segments(thinned(known))
                    self._whole.append(add_pieces(scene, f"{name}, all", pieces, colour, THIN_PX))
                    self._trails.append(trail(scene, name, TipPath(replay.times_s, known), stretches, colour))
        self.show_whole(False)

    def show(self, frame: int) -> None:
        """Draw the paths of the goals at a frame."""
        for trail in self._trails:
            trail.show(float(self._times_s[frame]))

    def show_whole(self, shown: bool) -> None:
        """Show the whole paths too, or hide them."""
        for node in self._whole:
            node.visible = shown


def stretches_of(replay: Replay, arm: str) -> NDArray[np.float64]:
    """Return the times (k,) in s that divide an arm's trial: starts and ends of its goals and of the trial."""
    start_s, end_s = float(replay.times_s[0]), float(replay.times_s[-1])
    ends = [time_s for goal in replay.goals if goal.arm == arm for time_s in (goal.start_s, goal.end_s)]
    return np.unique(np.clip([start_s, *ends, end_s], start_s, end_s))


class TipPath:
    """A path sampled every ``STEP_S``; its points are the same whichever part of it is drawn."""

    def __init__(self, times_s: NDArray[np.float64], points_m: NDArray[np.float64]) -> None:
        self._times_s, self._points_m = times_s, points_m
        self._clock_s = np.arange(times_s[0], times_s[-1] + STEP_S, STEP_S)
        self._on_clock_m = points_m[self._ticks(self._clock_s)]

    def between(self, start_s: float, end_s: float) -> NDArray[np.float64]:
        """Return the points (k, 3) from one time to another, both included."""
        first, last = np.searchsorted(self._clock_s, [start_s, end_s])
        start, end = self._points_m[self._ticks(np.array([start_s, end_s]))]
        return np.concatenate([start[None], self._on_clock_m[first:last], end[None]])

    def _ticks(self, times_s: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the ticks (k,) at times (k,)."""
        return np.clip(np.searchsorted(self._times_s, times_s - 1e-9), 0, len(self._times_s) - 1)


class PlannedTrail:
    """The planned path of the present goal."""

    def __init__(
        self, scene: SceneApi, name: str, path: TipPath, stretches_s: NDArray[np.float64], colour: Rgb
    ) -> None:
        self._path, self._stretches_s, self._drawn = path, stretches_s, stretch_at(stretches_s, stretches_s[0])
        self._node = add_pieces(scene, name, dashes(path.between(*self._drawn)), colour, THIN_PX)

    def show(self, time_s: float) -> None:
        """Draw the planned path of the goal at a time, unless it is drawn already."""
        stretch = stretch_at(self._stretches_s, time_s)
        if stretch != self._drawn:
            self._drawn, self._node.points = stretch, dashes(self._path.between(*stretch))


class DrivenTrail:
    """The driven path of the present goal, up to the tip."""

    def __init__(
        self, scene: SceneApi, name: str, path: TipPath, stretches_s: NDArray[np.float64], colour: Rgb
    ) -> None:
        self._path, self._stretches_s = path, stretches_s
        start_s = float(stretches_s[0])
        self._drawn = self._behind(start_s), path.between(start_s, start_s)
        self._nodes = [
            add_line(scene, f"{name}{part}", points, colour, width)
            for part, points, width in zip(("", ", now"), self._drawn, (THIN_PX, BOLD_PX), strict=True)
        ]

    def show(self, time_s: float) -> None:
        """Draw the path driven up to a time; update only parts that have changed."""
        parts = self._behind(time_s), self._path.between(time_s - NOW_S, time_s)
        for node, points, drawn in zip(self._nodes, parts, self._drawn, strict=True):
            if not np.array_equal(points, drawn):
                node.points = segments(points)
        self._drawn = parts

    def _behind(self, time_s: float) -> NDArray[np.float64]:
        start_s, _ = stretch_at(self._stretches_s, time_s)
        return self._path.between(start_s, max(start_s, LEAP_S * math.floor(time_s / LEAP_S + 1e-9)))


def stretch_at(stretches_s: NDArray[np.float64], time_s: float) -> tuple[float, float]:
    """Return start and end of the stretch that contains a time."""
    after = int(np.clip(np.searchsorted(stretches_s, time_s + 1e-9), 1, max(1, len(stretches_s) - 1)))
    return float(stretches_s[after - 1]), float(stretches_s[min(after, len(stretches_s) - 1)])


def dashes(points_m: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the dashes (k, 2, 3) of a path (n, 3), ``DASH_M`` long, or longer to limit their number."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1))])
    corners = np.arange(0.0, way[-1], max(DASH_M, way[-1] / MAX_POINTS))
    even = np.column_stack([np.interp(np.append(corners, way[-1]), way, column) for column in points_m.T])
    return segments(even if len(even) > 1 else points_m[[0, -1]])[::2]


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


def segments(points_m: NDArray) -> NDArray[np.float32]:
    """Return the pieces (k - 1, 2, 3) of a line."""
    return np.stack([points_m[:-1], points_m[1:]], axis=1).astype(np.float32)


def add_line(scene: SceneApi, name: str, points_m: NDArray, colour: Rgb, width_px: float) -> Any:
    """Add a line through points (k, 3) to the scene."""
    return add_pieces(scene, name, segments(points_m), colour, width_px)


def add_pieces(scene: SceneApi, name: str, pieces_m: NDArray[np.float32], colour: Rgb, width_px: float) -> Any:
    """Add pieces (k, 2, 3) of a line to the scene."""
    rgb = np.array(colour, dtype=np.uint8)
    return scene.add_line_segments(name, pieces_m, rgb, thickness=width_px, thickness_units="screen")


STEP_M = 1e-3  # a label stays in place while its arm moves less than this


class ArmLabels:
    """A label over each arm's tip that says what the arm is doing."""

    def __init__(self, scene: SceneApi, replay: Replay, film: Film, view: CameraView) -> None:
        paths = {arm: filled(path.p_world_driven_m) for arm, path in replay.tools.items()}
        above_m = above_tips_m(replay, view)
        self._places = {arm: p[film.ticks] + above_m[arm] for arm, p in paths.items() if p is not None}
        self._texts = {arm: captions(replay, film, arm) for arm in replay.tools}
        self._labels = {arm: add_arm_label(scene, arm, places[0]) for arm, places in self._places.items()}
        self.show(0)

    def show(self, frame: int) -> None:
        """Put the labels over the tips at a frame, with what the arms are doing."""
        for arm, label in self._labels.items():
            place = self._places[arm][frame]
            if np.linalg.norm(place - label.position) > STEP_M:
                label.position = place
            label.text = self._texts[arm][frame]


def add_arm_label(scene: SceneApi, arm: str, place_m: NDArray) -> Any:
    """Add an arm's label to the scene."""
    return scene.add_label(
        f"/arms/{arm}", arm, position=tuple(place_m.tolist()), anchor="bottom-center", font_screen_scale=1.2
    )


def above_tips_m(replay: Replay, view: CameraView) -> dict[str, NDArray[np.float64]]:
    """Return the offset (3,) of each arm's label from its tip; heights alternate, so that labels overlap less."""
    return {
        arm: np.array([0.0, 0.0, (LABEL + ROW * (number % 2)) * view.radius_m])
        for number, arm in enumerate(replay.tools)
    }


def captions(replay: Replay, film: Film, arm: str) -> list[str]:
    """Return for each frame the arm's name and what it is doing: the name of its shortest span at that time."""
    texts = [arm] * len(film.times_s)
    spans = [span for span in replay.spans if span[0] == arm]
    for _, name, start_s, end_s in sorted(spans, key=lambda span: span[2] - span[3]):  # the longest first
        first, last = np.searchsorted(film.times_s, [start_s, end_s])
        texts[first:last] = [f"{arm}: {name}"] * (last - first)
    return texts


def add_contact(scene: SceneApi, name: str, touch: Contact, radius_m: float) -> Any:
    """Add a ball with a label to the scene."""
    look = {"color": CONTACT, "opacity": 0.85, "cast_shadow": False}
    ball = scene.add_icosphere(name, radius_m, position=touch.p_world_m, **look)
    above = (0.0, 0.0, 1.5 * radius_m)
    scene.add_label(f"{name}/label", said_of(touch), position=above, anchor="bottom-center")
    return ball


def said_of(touch: Contact) -> str:
    """Return who touched, and how hard."""
    return f"{' - '.join(touch.between)}, {touch.force_n:.1f} N"


MIN_S = 0.5  # a shorter touch is shown for this long, to be visible at all


class Contacts:
    """A ball with a label at the place of each contact, shown while the contact lasts."""

    def __init__(self, scene: SceneApi, replay: Replay, film: Film, radius_m: float) -> None:
        self._times_s, self._touches = film.times_s, []
        for k, touch in enumerate(replay.contacts):
            ball = add_contact(scene, f"/contacts/{k}", touch, radius_m)
            ball.visible = False
            self._touches.append((ball, touch.time_s, max(touch.end_s, touch.time_s + MIN_S)))

    def show(self, frame: int) -> None:
        """Show the contacts of a frame."""
        time_s = float(self._times_s[frame])
        for ball, start_s, end_s in self._touches:
            ball.visible = start_s <= time_s < end_s  # viser sends only changes


LAMP = (-0.9, 1.6, 3.6)
"""Position of the lamp that casts shadows: right, front and up from the workspace's middle, in its radii."""

LIT = 3.0  # radii of the workspace that the lamp reaches


class Stage:
    """Everything that is drawn of a replay: bodies, paths, contacts and labels; at first those of the first frame."""

    def __init__(self, server: ViserServer, replay: Replay, film: Film, aspect: float = ASPECT) -> None:
        self.film = film
        view, scene = viewpoint(replay, film, aspect), server.scene
        set_up(server, replay, film, view)
        self.bodies = Bodies(scene, replay, film)
        self.paths = Paths(scene, replay, film)
        self._moments = (
            self.paths,
            Contacts(scene, replay, film, 0.035 * view.radius_m),
            ArmLabels(scene, replay, film, view),
        )

    def show(self, frame: int) -> None:
        """Show a frame, whatever was shown before."""
        self.bodies.show(frame)
        self.show_moments(frame)

    def show_moments(self, frame: int) -> None:
        """Show paths, contacts and labels of a frame, not its bodies."""
        for moment in self._moments:
            moment.show(frame)


def set_up(server: ViserServer, replay: Replay, film: Film, view: CameraView, *, live: bool = False) -> None:
    """Set view and light, and draw table and ports; each browser's view fits the shape of its window."""
    look_from(server, view)
    frame_windows(server, replay, film, live=live)
    light(server.scene, view)
    lay_table(server.scene, replay, film)
    add_ports(server.scene, replay, film)


def light(scene: SceneApi, view: CameraView) -> None:
    """Light a scene like a photo studio: one lamp that casts shadows.

    viser's own lamps are made for scenes of metres: their shadows begin centimetres behind the object that casts them.
    """
    scene.configure_default_lights(False)
    scene.configure_environment_map("studio", environment_intensity=0.3)
    scene.add_light_hemisphere("/light/sky", intensity=0.2, ground_color=(150, 150, 155))
    along, front, up = LAMP
    offset = view.radius_m * (along * view.right + front * view.front + up * np.array([0.0, 0.0, 1.0]))
    scene.add_light_spot(
        "/light/lamp",
        position=tuple((view.centre_m + offset).tolist()),
        direction=tuple((-offset).tolist()),
        intensity=1.4,
        angle=math.atan(LIT * view.radius_m / float(np.linalg.norm(offset))),
        penumbra=1.0,
        decay=0.0,
        cast_shadow=True,
    )
