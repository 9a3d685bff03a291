"""A cell in the browser while it runs: what a replay shows, at the present moment, and how its arms fare."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.replay import Contact, Replay
from trocar.view.film import shoot
from trocar.view.mesh import solid_mesh
from trocar.view.panels import WINDOW_S, Joints, JointsPanel, reduced
from trocar.view.replay import NOTICE
from trocar.view.server import close_server, open_server
from trocar.view.stage import (
    BOLD_PX,
    CONTACT,
    DRIVEN,
    MIN_S,
    PLANNED,
    Bodies,
    Rgb,
    add_contact,
    add_line,
    css,
    light,
    look_from,
    said_of,
    segments,
)
from trocar.view.trial_view import PANEL_PX, PANELS_PER_S, in_words
from trocar.view.viewpoint import viewpoint

TRAIL_S = 2.0
"""So much of a tip's path is drawn."""
KEPT_EVENTS, BALLS = 12, 50
PICTURES = 2
"""Place of the cameras in the panel, below clock and arms."""
TABLE: Rgb = (178, 184, 192)
GOOD: Rgb = (24, 132, 74)
WAITS: Rgb = (176, 108, 0)
BAD: Rgb = (190, 40, 40)
STATES: Mapping[str, Rgb] = {"ENABLED": GOOD, "PAUSED": WAITS}
"""Colours of CRTK's operating states; the others are bad."""


class Scene(Protocol):
    """What makes a replay of rows of arrays (``trocar.eval.scenery.Scenery``)."""

    def shown(
        self, title: str, times_s: NDArray[np.float64], arrays: Mapping[str, NDArray], planned: str = "desired"
    ) -> Replay:
        """Return a replay of arms and bodies alone."""
        ...


@dataclass(frozen=True)
class ArmFacts:
    """How an arm fares.

    Attributes:
        state: ``ENABLED``, ``PAUSED``, ``DISABLED`` or ``FAULT``.
        more: beside it: homed, busy.
        facts: texts by their headings.
    """

    state: str
    more: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Moment:
    """A cell at one time.

    Attributes:
        time_s: of its clock.
        arrays: one row each, named as those of a trial.
        arms: how they fare.
        clock: what is said about the clock.
        events: dicts with ``name`` and ``time_s``, since the moment before.
        contacts: likewise.
    """

    time_s: float
    arrays: Mapping[str, NDArray[np.float64]]
    arms: Mapping[str, ArmFacts] = field(default_factory=dict)
    clock: str = ""
    events: tuple[Mapping[str, object], ...] = ()
    contacts: tuple[Contact, ...] = ()


class LiveView:
    """A page that only this machine can open.

    Args:
        scene: of the cell.
        title: of the page, one line.
        moment: the first one.
        port: of the server; if it is taken, the next free one; 0: any free one.

    Attributes:
        server: viser's server.

    Raises:
        TrocarError: viser is not installed.
    """

    def __init__(self, scene: Scene, title: str, moment: Moment, port: int = 8080) -> None:
        self._scene, self._title = scene, title
        self._rows: deque[Moment] = deque()
        self._said: deque[str] = deque(maxlen=KEPT_EVENTS)
        self._due_s = 0.0
        replay = self._replay([moment])
        film = shoot(replay)
        view = viewpoint(replay, film, live=True)
        self._moving, self._radius_m = film.bodies, 0.035 * view.radius_m
        self.server = open_server(port)
        with self.server.atomic():
            look_from(self.server, view)
            light(self.server.scene, view)
            self._lay_table(replay)
            self._bodies = Bodies(self.server.scene, replay, film)
            self._tips = [Tip(self.server.scene, arm, replay, 0.4 * view.radius_m) for arm in replay.tools]
            self._balls: list[tuple[Any, float]] = []
            self._touches = 0
            self._add_panels(replay)
        self.show(moment)

    @property
    def port(self) -> int:
        """Return the port that the server got."""
        return self.server.get_port()

    @property
    def watched(self) -> bool:
        """Return whether a browser has the page open."""
        return bool(self.server.get_clients())

    def show(self, moment: Moment) -> None:
        """Show the next moment."""
        self._rows.append(moment)
        while self._rows[0].time_s < moment.time_s - WINDOW_S:
            self._rows.popleft()
        for event in moment.events:
            self._note(float(event["time_s"]), in_words(event))  # type: ignore[arg-type]
        for touch in moment.contacts:
            self._note(touch.time_s, f"contact: {said_of(touch)}")
        replay = self._replay([moment])
        with self.server.atomic():
            poses = [replay.T_world_body[body] for body in self._moving]
            self._bodies.place(
                np.array([T.translation_m[0] for T in poses], dtype=np.float32).reshape(-1, 3),
                np.array([T.rotation.as_quaternion()[0] for T in poses], dtype=np.float32).reshape(-1, 4),
            )
            for tip in self._tips:
                tip.show(replay, moment)
            self._show_contacts(moment)
            if time.monotonic() >= self._due_s:
                self._due_s = time.monotonic() + 1.0 / PANELS_PER_S
                self._show_panels(moment)

    def show_image(self, camera: str, color: NDArray[np.uint8], said: str) -> None:
        """Show an image (h, w, 3) of a camera, with what is said about it."""
        shown = self._cameras.get(camera)
        if shown is None:
            with self.server.gui.add_folder(f"Camera: {camera}", order=PICTURES):
                words = self.server.gui.add_markdown("")
                picture = self.server.gui.add_image(np.full((9, 16, 3), 235, np.uint8), format="jpeg")
            shown = self._cameras[camera] = words, picture
        words, picture = shown
        words.content, picture.image = said, reduced(Image.fromarray(color))

    def close(self) -> None:
        """Stop serving."""
        close_server(self.server)

    def _replay(self, rows: list[Moment]) -> Replay:
        times_s = np.array([row.time_s for row in rows])
        arrays = {name: np.concatenate([row.arrays[name] for row in rows]) for name in rows[0].arrays}
        return self._scene.shown(self._title, times_s, arrays, "measured")

    def _note(self, time_s: float, words: str) -> None:
        self._said.appendleft(f"<b>{time_s:.2f} s</b> {escape(words)}")

    def _show_contacts(self, moment: Moment) -> None:
        """Show new touches, each for a while."""
        for touch in moment.contacts:
            self._touches += 1
            ball = add_contact(self.server.scene, f"/contacts/{self._touches % BALLS}", touch, self._radius_m)
            self._balls.append((ball, moment.time_s + 2 * MIN_S))
        for ball, end_s in self._balls:
            if end_s <= moment.time_s:
                ball.remove()
        self._balls = [(ball, end_s) for ball, end_s in self._balls if end_s > moment.time_s]

    def _lay_table(self, replay: Replay) -> None:
        """Lay a table below what never moves, if there is anything."""
        fixed = [solid for solid in replay.solids if solid.body not in self._moving]
        corners = [
            (replay.T_world_body[solid.body] @ solid.T_body_solid).apply(
                solid_mesh(solid).vertices_m.astype(np.float64)
            )
            for solid in fixed
        ]
        if corners:
            low, high = np.concatenate(corners).min(0), np.concatenate(corners).max(0)
            width, depth = 2.2 * (high - low)[:2]
            look: dict[str, Any] = {"cell_thickness": 0.0, "section_thickness": 0.0, "shadow_opacity": 0.25}
            look |= {"plane_color": TABLE, "plane_opacity": 1.0}
            middle = (*((low + high) / 2)[:2].tolist(), float(low[2]))
            self.server.scene.add_grid("/table", width, depth, position=middle, **look)

    def _add_panels(self, replay: Replay) -> None:
        gui = self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.set_panel_label(self._title)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_PX)
        gui.add_markdown(f"*{NOTICE}*", order=0)
        self._state = gui.add_html("", order=1)
        self._cameras: dict[str, tuple[Any, Any]] = {}
        with gui.add_folder("Events", order=PICTURES + 1):
            self._events = gui.add_html("")
        self._joints: dict[str, JointsPanel] = {}
        with gui.add_folder("Joints", order=PICTURES + 2):
            tabs = gui.add_tab_group()
            for arm in replay.tools:
                joints = Joints.of(replay, arm)
                if joints is not None:
                    with tabs.add_tab(arm):
                        self._joints[arm] = JointsPanel(gui, joints, ahead_s=0.0)

    def _show_panels(self, moment: Moment) -> None:
        cards = [card(tip.arm, moment.arms[tip.arm], tip.off_m) for tip in self._tips if tip.arm in moment.arms]
        self._state.content = box(f"<b>{moment.time_s:.1f} s</b> &ensp; {escape(moment.clock)}{LEGEND}{''.join(cards)}")
        self._events.content = box("<br>".join(self._said) or "none so far")
        replay = self._replay(list(self._rows))
        for arm, panel in self._joints.items():
            joints = Joints.of(replay, arm)
            assert joints is not None
            panel.renew(joints)


class Tip:
    """One arm's tip: where it truly went, where the encoders say it went, and a label above it.

    Attributes:
        arm: name.
        off_m: between the two places.
    """

    def __init__(self, scene: Any, arm: str, replay: Replay, above_m: float) -> None:
        self.arm, self.off_m = arm, 0.0
        self._above_m = np.array([0.0, 0.0, above_m])
        self._points: deque[tuple[float, NDArray[np.float32]]] = deque()
        self._points.append((-np.inf, self._places(replay)))
        start = np.stack([self._points[0][1]] * 2)
        self._lines = [
            add_line(scene, f"/paths/{arm} {kind}", start[:, k], colour, BOLD_PX)
            for k, (kind, colour) in enumerate((("by its encoders", PLANNED), ("true", DRIVEN)))
        ]
        self._dot = scene.add_icosphere(
            f"/paths/{arm} by its encoders, now", DOT_M, color=PLANNED, opacity=0.9, cast_shadow=False
        )
        self._label = scene.add_label(f"/arms/{arm}", arm, anchor="bottom-center", font_screen_scale=1.2)

    def show(self, replay: Replay, moment: Moment) -> None:
        """Draw a moment."""
        places = self._places(replay)
        self.off_m = float(np.linalg.norm(places[1] - places[0]))
        self._points.append((moment.time_s, places))
        while len(self._points) > 2 and self._points[0][0] < moment.time_s - TRAIL_S:
            self._points.popleft()
        trail = np.stack([points for _, points in self._points])
        for k, line in enumerate(self._lines):
            line.points = segments(trail[:, k])
        self._dot.position, self._label.position = places[0], places[1] + self._above_m
        facts = moment.arms.get(self.arm)
        self._label.text = self.arm if facts is None else f"{self.arm}: {facts.state}"

    def _places(self, replay: Replay) -> NDArray[np.float32]:
        """Return the tip by the encoders, and the true one (2, 3)."""
        path = replay.tools[self.arm]
        return np.stack([path.p_world_planned_m[0], path.p_world_driven_m[0]]).astype(np.float32)


DOT_M = 1e-3


def box(html: str) -> str:
    """Return a piece of the panel."""
    return f'<div style="font-size:13px;line-height:1.55;padding:2px 14px;overflow-wrap:anywhere">{html}</div>'


def card(arm: str, found: ArmFacts, off_m: float) -> str:
    """Return what is told about an arm."""
    badge = (
        f'<span style="background:{css(STATES.get(found.state, BAD))};color:#fff;border-radius:4px;padding:1px 7px;'
        f'font-size:12px">{escape(found.state)}</span>'
    )
    facts = {"tip": f"{1e3 * off_m:.1f} mm from where its encoders say it is", **found.facts}
    rows = "".join(
        f'<div style="display:flex"><span style="flex:0 0 110px;color:#6b7078">{escape(name)}</span>'
        f"<span>{escape(text)}</span></div>"
        for name, text in facts.items()
    )
    head = f'<div style="margin-bottom:2px"><b>{escape(arm)}</b> &ensp;{badge}&ensp; {escape(found.more)}</div>'
    return f'<div style="border:1px solid #d9dce0;border-radius:6px;padding:6px 10px;margin-top:8px">{head}{rows}</div>'


def _entry(colour: Rgb, name: str) -> str:
    return (
        f'<span style="display:inline-block;width:18px;height:4px;margin:0 6px 3px 0;vertical-align:middle;'
        f'background:{css(colour)}"></span>{name} &ensp;'
    )


LEGEND = (
    f'<div style="font-size:12px;color:#59606a">{_entry(DRIVEN, "tip, true")}'
    f"{_entry(PLANNED, 'tip, by its encoders')}{_entry(CONTACT, 'contact')}</div>"
)
