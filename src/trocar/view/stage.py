"""The stage: a scene's bodies at their poses, light, and what is drawn over them: paths, contacts, labels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.replay import Contact, Replay
from trocar.view.film import Film
from trocar.view.mesh import Mesh, Rgba, body_parts
from trocar.view.viewpoint import FIELD_RAD, Viewpoint, viewpoint

if TYPE_CHECKING:
    from viser import SceneApi, ViserServer


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
                    add_line(scene, f"{name}, all", thinned(known), colour, THIN_PX).visible = False
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
        self._node = add_line(scene, f"{name}, {part.name}", self._drawn, colour, part.width_px)

    def show(self, time_s: float) -> None:
        """Draw the stretch about a time, unless it is drawn already."""
        stretch = self._stretch(time_s)
        if not np.array_equal(stretch, self._drawn):
            self._drawn = stretch
            self._node.points = segments(stretch)

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


def segments(points_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the pieces (k - 1, 2, 3) of a line."""
    return np.stack([points_m[:-1], points_m[1:]], axis=1)


def add_line(scene: SceneApi, name: str, points_m: NDArray[np.float32], colour: Rgb, width_px: float):
    """Add a line to the scene; thin ones are greyer."""
    grey = GREYED if width_px == THIN_PX else 0.0
    rgb = np.rint((1 - grey) * np.array(colour) + grey * np.array(GREY)).astype(np.uint8)
    return scene.add_line_segments(name, segments(points_m), rgb, thickness=width_px, thickness_units="screen")


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
    """A ball with a label at the place of each contact, seen while it lasts."""

    def __init__(self, scene: SceneApi, replay: Replay, film: Film, radius_m: float) -> None:
        self._times_s, self._touches = film.times_s, []
        for k, touch in enumerate(replay.contacts):
            ball = add_contact(scene, f"/contacts/{k}", touch, radius_m)
            ball.visible = False
            self._touches.append((ball, touch.time_s, max(touch.end_s, touch.time_s + MIN_S)))

    def show(self, frame: int) -> None:
        """Show the touches of a frame."""
        time_s = float(self._times_s[frame])
        for ball, start_s, end_s in self._touches:
            ball.visible = start_s <= time_s < end_s  # viser sends what has changed


class Bodies:
    """Bodies at their poses; those that move are nodes ``/bodies/NAME`` in the world's frame, first as in frame 0."""

    def __init__(self, scene: SceneApi, replay: Replay, film: Film) -> None:
        self._scene, self._moved = scene, film.moved
        # the precision that a browser draws with
        self._position_m, self._wxyz = film.position_m.astype(np.float32), film.wxyz.astype(np.float32)
        parts = body_parts(replay.solids)
        for body in parts:
            if body not in film.bodies:
                self._draw(body, parts[body], replay.T_world_body[body])
        first = {body: SE3.unchecked(replay.T_world_body[body].matrix[film.ticks[0]]) for body in film.bodies}
        self._nodes = [self._draw(body, parts[body], first[body]) for body in film.bodies]

    def moved(self, frame: int) -> Iterator[tuple[str, NDArray[np.float32], NDArray[np.float32]]]:
        """Yield name, position (3,) m and wxyz (4,) of the nodes that have moved since the previous frame."""
        for i in np.flatnonzero(self._moved[:, frame]).tolist():
            yield self._nodes[i].name, self._position_m[i, frame], self._wxyz[i, frame]

    def show(self, frame: int) -> None:
        """Move all bodies to their poses at a frame."""
        self.place(self._position_m[:, frame], self._wxyz[:, frame])

    def place(self, position_m: NDArray[np.float32], wxyz: NDArray[np.float32]) -> None:
        """Move all bodies, in the order of the film's, to these positions (m, 3) and orientations (m, 4)."""
        for node, position, turned in zip(self._nodes, position_m, wxyz, strict=True):
            node.position, node.wxyz = position, turned

    def _draw(self, body: str, parts: dict[Rgba, Mesh], T_world_body: SE3) -> Any:
        """Add a body to the scene and return its node."""
        name = "/bodies/" + body.replace("/", "|")  # a slash would attach one body to another
        position, wxyz = T_world_body.translation_m, T_world_body.rotation.as_quaternion()
        node = self._scene.add_frame(name, show_axes=False, position=position, wxyz=wxyz)
        for number, ((*rgb, alpha), mesh) in enumerate(parts.items()):
            colour, opacity = np.rint(255 * np.clip(rgb, 0.0, 1.0)).astype(np.uint8), alpha if alpha < 1 else None
            self._scene.add_mesh_simple(f"{name}/{number}", mesh.vertices_m, mesh.faces, color=colour, opacity=opacity)
        return node


LAMP = (-0.9, 1.6, 3.6)
"""Position of the lamp that casts shadows: right, front and up from the workspace's middle, in its radii."""

LIT = 3.0  # radii of the workspace that the lamp reaches


class Stage:
    """Everything that is drawn of a replay, first at the first frame of its film: bodies, and what is over them."""

    def __init__(self, server: ViserServer, replay: Replay, film: Film) -> None:
        self.film = film
        view, scene = viewpoint(replay, film), server.scene
        look_from(server, view)
        light(scene, view)
        self.bodies = Bodies(scene, replay, film)
        self._moments = (
            Paths(scene, replay, film),
            Contacts(scene, replay, film, 0.035 * view.radius_m),
            ArmLabels(scene, replay, film, 0.4 * view.radius_m),
        )

    def show(self, frame: int) -> None:
        """Show a frame, whatever was shown before."""
        self.bodies.show(frame)
        self.show_moments(frame)

    def show_moments(self, frame: int) -> None:
        """Show paths, contacts and labels of a frame, not its bodies."""
        for moment in self._moments:
            moment.show(frame)


def look_from(server: ViserServer, view: Viewpoint) -> None:
    """Set the initial view of the page."""
    camera = server.initial_camera
    camera.position, camera.look_at, camera.up = view.eye_m, view.centre_m, (0.0, 0.0, 1.0)
    camera.fov = FIELD_RAD
    camera.near = 0.02 * float(np.linalg.norm(view.eye_m - view.centre_m))


def light(scene: SceneApi, view: Viewpoint) -> None:
    """Light a scene like a photo studio: one lamp that casts shadows, and a plain background.

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
    height = np.linspace(0.0, 1.0, 128)[:, None, None]
    scene.set_background_image(np.tile((1 - height) * SKY + height * HORIZON, (1, 4, 1)).astype(np.uint8), "png")
