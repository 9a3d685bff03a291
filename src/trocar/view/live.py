"""A cell in the browser while it runs: what a replay shows, at the present moment, and the state of its arms."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from html import escape
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.geometry import SE3
from trocar.replay import Contact, Replay
from trocar.view.bodies import Bodies
from trocar.view.camera_panel import reduced, with_outlines
from trocar.view.film import STILL_M, shoot
from trocar.view.joints_panel import Joints, add_joints
from trocar.view.recent import Recent, add_recent
from trocar.view.replay import notice
from trocar.view.server import close_server, open_panel, open_server
from trocar.view.stage import (
    BOLD_PX,
    CONTACT,
    MIN_S,
    THIN_PX,
    Rgb,
    above_tips_m,
    add_arm_label,
    add_contact,
    add_line,
    arm_colours,
    css,
    said_of,
    segments,
    set_up,
)
from trocar.view.surroundings import add_ports, lay_table
from trocar.view.timeline import WINDOW_S, LiveTimeLine, Span
from trocar.view.trial_view import in_words
from trocar.view.viewpoint import BESIDE_PANEL, CameraView, viewpoint

TRAIL_S = 2.0
"""Duration of the part of a tip's path that is drawn."""
KEPT_EVENTS, BALLS = 12, 50
STEPS, PICTURES, EVENTS, JOINTS, LAST = range(2, 7)
"""Places in the panel, below clock and arms."""
PANELS_PER_S = 5.0
"""Updates of the panel beside the scene, a second of the wall clock."""
RATE_S = 2.0
"""Time over which the clock's rate is averaged."""
GOOD: Rgb = (24, 132, 74)
WAITS: Rgb = (176, 108, 0)
BAD: Rgb = (190, 40, 40)
STATES: Mapping[str, Rgb] = {"ENABLED": GOOD, "PAUSED": WAITS}
"""Colours of CRTK's operating states; all others are ``BAD``."""


class Scene(Protocol):
    """Makes a replay from rows of arrays (``trocar.eval.scenery.Scenery``)."""

    def shown(
        self, title: str, times_s: NDArray[np.float64], arrays: Mapping[str, NDArray], planned: str = "desired"
    ) -> Replay:
        """Return a replay of arms and bodies only."""
        ...


@dataclass(frozen=True)
class ArmFacts:
    """The state of an arm.

    Attributes:
        state: ``ENABLED``, ``PAUSED``, ``DISABLED`` or ``FAULT``.
        more: shown beside the state: homed, busy.
        facts: texts by their headings.
    """

    state: str
    more: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Moment:
    """The state of a cell at one time.

    Attributes:
        time_s: of its clock.
        arrays: one row each, named as those of a trial.
        arms: the arms' states, by name.
        clock: text beside the clock.
        events: dicts with ``name`` and ``time_s``, since the previous moment.
        contacts: likewise.
        spans: the scripts' spans that have ended since the previous moment.
        begun: spans that have not ended: arm, name and start in s.
        made_s: when it was made, on the machine's monotonic clock.
    """

    time_s: float
    arrays: Mapping[str, NDArray[np.float64]]
    arms: Mapping[str, ArmFacts] = field(default_factory=dict)
    clock: str = ""
    events: tuple[Mapping[str, object], ...] = ()
    contacts: tuple[Contact, ...] = ()
    spans: tuple[Span, ...] = ()
    begun: tuple[tuple[str, str, float], ...] = ()
    made_s: float = field(default_factory=time.monotonic)


class Picture(NamedTuple):
    """An image of a camera.

    Attributes:
        camera: name.
        color: (h, w, 3).
        said: text about it.
        outlines_px: closed outline (n, 2) in pixels of each thing that perception found in it, by name.
    """

    camera: str
    color: NDArray[np.uint8]
    said: str
    outlines_px: Mapping[str, NDArray[np.float64]] = MappingProxyType({})


class LiveView:
    """A live page that only this machine can open.

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
        self._joints_at: Recent[Mapping[str, Mapping[str, NDArray]]] = deque()
        self._said: deque[str] = deque(maxlen=KEPT_EVENTS)
        self._due_s = 0.0
        self._clock: deque[tuple[float, float]] = deque()  # wall clock, cell's clock
        replay = self._replay(moment)
        film = shoot(replay)
        view = viewpoint(replay, film, BESIDE_PANEL, live=True)
        self._moving, self._radius_m = film.bodies, 0.035 * view.radius_m
        self._anew = False
        self.server = open_server(port)
        with self.server.atomic():
            set_up(self.server, replay, film, view, live=True)
            self._bodies = Bodies(self.server.scene, replay, film)
            self._tips = [
                Tip(self.server.scene, arm, colour, replay, view) for arm, colour in arm_colours(replay).items()
            ]
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
        replay = self._replay(moment)
        add_recent(self._joints_at, moment.time_s, replay.joints, WINDOW_S)
        for event in moment.events:
            self._note(float(event["time_s"]), in_words(event))  # type: ignore[arg-type]
        for touch in moment.contacts:
            self._note(touch.time_s, f"contact: {said_of(touch)}")
        self._time_line.add(moment.spans)
        self._clock.append((moment.made_s, moment.time_s))
        while self._clock[0][0] < moment.made_s - RATE_S and len(self._clock) > 2:
            self._clock.popleft()
        with self.server.atomic():
            if self._anew:
                self._draw_anew(replay)
            poses = SE3.unchecked(np.array([replay.T_world_body[b].matrix[0] for b in self._moving]).reshape(-1, 4, 4))
            turns = poses.rotation.as_quaternion()
            self._bodies.place(poses.translation_m.astype(np.float32), turns.astype(np.float32))
            for tip in self._tips:
                tip.show(replay, moment)
            self._show_contacts(moment)
            if time.monotonic() >= self._due_s:
                self._due_s = time.monotonic() + 1.0 / PANELS_PER_S
                self._show_panels(moment, replay)

    def begin(self, scene: Scene) -> None:
        """Show another scene of the same arms from now on; its clock starts again at 0."""
        self._scene = scene
        self._anew = True
        self._joints_at.clear()
        self._said.clear()
        self._clock.clear()
        self._time_line.clear()
        for ball, _ in self._balls:
            ball.remove()
        self._balls.clear()
        for tip in self._tips:
            tip.forget()

    def _draw_anew(self, replay: Replay) -> None:
        """Draw the bodies of a new scene and their surroundings: each trial has its own."""
        self._anew = False
        film, scene = shoot(replay), self.server.scene
        self._moving = film.bodies
        self._bodies.begin(replay, film)
        lay_table(scene, replay, film)
        add_ports(scene, replay, film)

    def show_image(self, picture: Picture) -> None:
        """Show an image of a camera, with what is said about it, and what was found in it."""
        shown = self._cameras.get(picture.camera)
        if shown is None:
            with self.server.gui.add_folder(f"Camera: {picture.camera}", order=PICTURES):
                words = self.server.gui.add_markdown("")
                image = self.server.gui.add_image(np.full((9, 16, 3), 235, np.uint8), format="jpeg")
            shown = self._cameras[picture.camera] = words, image
        words, image = shown
        words.content = picture.said
        image.image = reduced(Image.fromarray(with_outlines(picture.color, picture.outlines_px)))

    @property
    def rate(self) -> float:
        """Return the recent rate of the cell's clock, in seconds per second of the wall clock."""
        (began_s, from_s), (now_s, to_s) = self._clock[0], self._clock[-1]
        return (to_s - from_s) / max(now_s - began_s, 1e-3)

    def close(self) -> None:
        """Stop serving."""
        close_server(self.server)

    def _replay(self, moment: Moment) -> Replay:
        return self._scene.shown(self._title, np.array([moment.time_s]), moment.arrays, "measured")

    def _note(self, time_s: float, words: str) -> None:
        self._said.appendleft(f"<b>{time_s:.2f} s</b> {escape(words)}")

    def _show_contacts(self, moment: Moment) -> None:
        """Show new contacts, each for a while."""
        for touch in moment.contacts:
            self._touches += 1
            ball = add_contact(self.server.scene, f"/contacts/{self._touches % BALLS}", touch, self._radius_m)
            self._balls.append((ball, moment.time_s + 2 * MIN_S))
        for ball, end_s in self._balls:
            if end_s <= moment.time_s:
                ball.remove()
        self._balls = [(ball, end_s) for ball, end_s in self._balls if end_s > moment.time_s]

    def _add_panels(self, replay: Replay) -> None:
        gui = self.server.gui
        open_panel(self.server, self._title, notice(replay))
        self._legend = legend(replay)
        self._state = gui.add_html("", order=1)
        self._cameras: dict[str, tuple[Any, Any]] = {}
        self._steps = gui.add_folder("Steps", order=STEPS, visible=False)
        with self._steps:
            self._time_line = LiveTimeLine(gui)
        with gui.add_folder("Events", order=EVENTS):
            self._events = gui.add_html("")
        with gui.add_folder("Joints", order=JOINTS):
            self._joints = add_joints(gui, replay, ahead_s=0.0)

    def _show_panels(self, moment: Moment, replay: Replay) -> None:
        cards = [card(tip, moment.arms[tip.arm]) for tip in self._tips if tip.arm in moment.arms]
        clock = f"<b>{moment.time_s:.1f} s</b> &ensp; {self.rate:.2f} x real time &ensp; {escape(moment.clock)}"
        self._state.content = box(f"{clock}{self._legend}{''.join(cards)}")
        self._steps.visible |= bool(moment.begun)
        self._time_line.show(moment.time_s, moment.begun)
        self._events.content = box("<br>".join(self._said) or "none so far")
        times_s = np.array([time_s for time_s, _ in self._joints_at])
        for arm, panel in self._joints.items():
            rows = {kind: np.concatenate([at[arm][kind] for _, at in self._joints_at]) for kind in replay.joints[arm]}
            joints = Joints.of(replace(replay, times_s=times_s, joints={arm: rows}), arm)
            assert joints is not None
            panel.renew(joints)


class Tip:
    """One arm's tip: where it truly went, where the encoders say it went, and a label above it.

    Attributes:
        arm: name.
        colour: of the arm.
        off_m: distance between the true tip and the one by the encoders.
    """

    def __init__(self, scene: Any, arm: str, colour: Rgb, replay: Replay, view: CameraView) -> None:
        self.arm, self.colour, self.off_m = arm, colour, 0.0
        self._rested = False  # for as long as its trail is drawn
        self._above_m = above_tips_m(replay, view)[arm]
        self._points: Recent[NDArray[np.float32]] = deque([(-np.inf, self._places(replay))])
        start = np.stack([self._points[0][1]] * 2)
        self._lines = [
            add_line(scene, f"/paths/{arm} {kind}", start[:, k], colour, width)
            for k, (kind, width) in enumerate((("by its encoders", THIN_PX), ("true", BOLD_PX)))
        ]
        self._dot = scene.add_icosphere(
            f"/paths/{arm} by its encoders, now", DOT_M, color=colour, opacity=0.9, cast_shadow=False
        )
        self._label = add_arm_label(scene, arm, self._points[0][1][1] + self._above_m)

    def forget(self) -> None:
        """Forget where the tip has been."""
        self._points = deque([(-np.inf, self._points[-1][1])])

    def show(self, replay: Replay, moment: Moment) -> None:
        """Draw a moment."""
        places, last = self._places(replay), self._points[-1][1]
        self.off_m = float(np.linalg.norm(places[1] - places[0]))
        if np.abs(places - last).max() <= STILL_M:
            places = last
        add_recent(self._points, moment.time_s, places, TRAIL_S)
        rests = self._points[0][1] is places
        if not (rests and self._rested):  # else it is drawn already
            trail = np.stack([points for _, points in self._points])
            for k, line in enumerate(self._lines):
                line.points = segments(trail[:, k])
            self._dot.position, self._label.position = places[0], places[1] + self._above_m
        self._rested = rests
        doing = [name for arm, name, _ in moment.begun if arm == self.arm][-1:]  # the innermost
        if self.arm in moment.arms:
            doing.append(moment.arms[self.arm].state)
        self._label.text = f"{self.arm}: {', '.join(doing)}" if doing else self.arm

    def _places(self, replay: Replay) -> NDArray[np.float32]:
        """Return the tip by the encoders, and the true one (2, 3)."""
        path = replay.tools[self.arm]
        return np.stack([path.p_world_planned_m[0], path.p_world_driven_m[0]]).astype(np.float32)


DOT_M = 1e-3


def box(html: str) -> str:
    """Return HTML in the style of the panel."""
    return f'<div style="font-size:13px;line-height:1.55;padding:2px 14px;overflow-wrap:anywhere">{html}</div>'


def card(tip: Tip, found: ArmFacts) -> str:
    """Return an arm's state and facts as HTML."""
    badge = (
        f'<span style="background:{css(STATES.get(found.state, BAD))};color:#fff;border-radius:4px;padding:1px 7px;'
        f'font-size:12px">{escape(found.state)}</span>'
    )
    facts = {"tip": f"{1e3 * tip.off_m:.1f} mm from where its encoders say it is", **found.facts}
    name = f"{line(tip.colour, 4)}<b>{escape(tip.arm)}</b>"
    head = f'<div style="margin-bottom:2px">{name} &ensp;{badge}&ensp; {escape(found.more)}</div>'
    style = "border:1px solid #9aa1a9;border-radius:6px;padding:6px 10px;margin-top:8px"
    return f'<div style="{style}">{head}{table(facts)}</div>'


def table(facts: Mapping[str, str], width_px: int = 110) -> str:
    """Return texts beside headings of this width, as HTML."""
    return "".join(
        f'<div style="display:flex"><span style="flex:0 0 {width_px}px;opacity:.7">{escape(name)}</span>'
        f"<span>{escape(text)}</span></div>"
        for name, text in facts.items()
    )


def line(colour: Rgb, width_px: int) -> str:
    """Return a short line as in the scene, for a legend."""
    return (
        f'<span style="display:inline-block;width:18px;height:{width_px}px;margin:0 6px 3px 0;vertical-align:middle;'
        f'background:{css(colour)}"></span>'
    )


INK: Rgb = (122, 130, 140)


def legend(replay: Replay) -> str:
    """Return the legend of the scene's lines; without true joints, there is no line of the true tip."""
    true = f"{line(INK, 4)}tip, true &ensp;" if any("true" in kinds for kinds in replay.joints.values()) else ""
    others = f"{line(INK, 1)}tip, by its encoders &ensp;{line(CONTACT, 8)}contact"
    return f'<div style="font-size:12px;opacity:.8">{true}{others}</div>'
