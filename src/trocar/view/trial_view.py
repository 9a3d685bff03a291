"""A trial in the browser: the scene of ``replay.html``, and beside it panels that need a server."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from trocar.replay import Replay
from trocar.view.camera_panel import CameraPanel
from trocar.view.film import last_until, shoot
from trocar.view.joints_panel import JointsPanel, add_joints
from trocar.view.replay import notice
from trocar.view.server import close_server, open_panel, open_server
from trocar.view.stage import Stage, said_of
from trocar.view.timeline import ErrorPanel, TimeLinePanel
from trocar.view.viewpoint import BESIDE_PANEL

if TYPE_CHECKING:
    from viser import GuiApi

SPEEDS = {"x 0.1": 0.1, "x 0.25": 0.25, "x 0.5": 0.5, "x 1": 1.0, "x 2": 2.0, "x 4": 4.0, "x 8": 8.0}
FRAMES_PER_S = 30.0
PANELS_PER_S = 8.0  # updates of the numbers and pictures beside the scene, while it plays


class TrialView:
    """A replay on a server that only this machine can reach; :meth:`play` lets time run there.

    Args:
        replay: to be shown.
        port: of the server; if it is taken, the next free one; 0: any free one.

    Attributes:
        server: viser's server.
        stage: the scene.
        jumps: time in s of each event, contact and missed goal, by its text in the menu.
        time_s: the time shown.
        plays: whether time runs while :meth:`play` is running.

    Raises:
        TrocarError: viser is not installed, or the replay is inconsistent.
    """

    def __init__(self, replay: Replay, port: int = 8080) -> None:
        film = shoot(replay, (FRAMES_PER_S,))
        self._times_s = replay.times_s
        self.time_s, self.plays = float(replay.times_s[0]), False
        self._lock = threading.RLock()
        self._panels_due_s = 0.0
        self.jumps = jumps(replay)
        self.server = open_server(port)
        with self.server.atomic():
            self.stage = Stage(self.server, replay, film, BESIDE_PANEL)
            self._add_controls(replay)
            self._panels = _panels(self.server.gui, replay)
        self.show(self.time_s)

    @property
    def port(self) -> int:
        """Return the port that the server got."""
        return self.server.get_port()

    def show(self, time_s: float) -> None:
        """Show a time, clipped to the first and the last."""
        with self._lock:
            self._show_scene(time_s)
            self._show_panels()

    def run(self, plays: bool) -> None:
        """Play, from the beginning if the end is reached, or pause."""
        with self._lock:
            if plays and self.time_s >= self._times_s[-1]:
                self.show(float(self._times_s[0]))
            self.plays = plays
            self._button.label = "Pause" if plays else "Play"
            if not plays:
                self._show_panels()

    def advance(self, seconds: float) -> None:
        """Advance by these seconds of the wall clock, at the chosen speed; stop at the end."""
        with self._lock:
            self._show_scene(self.time_s + SPEEDS[self._speed.value] * seconds)
            if time.monotonic() >= self._panels_due_s:
                self._show_panels()
            if self.time_s >= self._times_s[-1]:
                self.run(False)

    def play(self) -> None:
        """Advance time while :attr:`plays` is set; ends with Ctrl-C."""
        before = time.monotonic()
        while True:
            time.sleep(1.0 / FRAMES_PER_S)
            now = time.monotonic()
            if self.plays:
                self.advance(now - before)
            before = now

    def close(self) -> None:
        """Stop serving."""
        close_server(self.server)

    def _show_scene(self, time_s: float) -> None:
        self.time_s = float(np.clip(time_s, self._times_s[0], self._times_s[-1]))
        with self.server.atomic():
            self.stage.show(self.stage.film.frame_at(self.time_s))

    def _show_panels(self) -> None:
        tick = last_until(self._times_s, self.time_s)
        with self.server.atomic():
            self._slider.value = round(self.time_s, 2)
            for panel in self._panels:
                panel.show(tick)
        self._panels_due_s = time.monotonic() + 1.0 / PANELS_PER_S

    def _add_controls(self, replay: Replay) -> None:
        """Add title, button, slider, speed and menu of events."""
        gui = self.server.gui
        open_panel(self.server, replay.title, notice(replay))
        self._button = gui.add_button("Play")
        start, end = float(self._times_s[0]), float(self._times_s[-1])
        marks = tuple(sorted({round(time_s, 2) for time_s in troubles(replay)}))
        self._slider = gui.add_slider("time, s", start, max(end, start + 0.01), 0.01, start, marks=marks or None)
        self._speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="x 1")
        self._button.on_click(lambda _: self.run(not self.plays))
        self._slider.on_update(self._slid)
        if replay.tools:
            whole = gui.add_checkbox("whole paths", False)
            whole.on_update(lambda _: self.stage.paths.show_whole(whole.value))
        if self.jumps:
            self._menu = gui.add_dropdown("jump to", ("choose", *self.jumps))
            self._menu.on_update(self._chosen)

    async def _slid(self, event: Any) -> None:
        # viser calls an async function at once: while it plays, the next frame sets the slider back
        if event.client is not None:  # moved by the user, not by this program
            self.show(self._slider.value)

    def _chosen(self, event: Any) -> None:
        if event.client is not None and self._menu.value in self.jumps:
            self.run(False)
            self.show(self.jumps[self._menu.value])


def jumps(replay: Replay) -> dict[str, float]:
    """Return the time in s of each event, contact and missed goal, by its description, in order of time."""
    found = [(touch.time_s, f"contact: {said_of(touch)}") for touch in replay.contacts]
    found += [(goal.end_s, f"missed: goal {goal.number + 1}, {goal.arm}") for goal in replay.goals if goal.failed]
    found += [(float(event["time_s"]), in_words(event)) for event in replay.events]  # type: ignore[arg-type]
    return {f"{at:.2f} s  {words}": at for at, words in sorted(found)}


def troubles(replay: Replay) -> list[float]:
    """Return the times in s at which contacts began or missed goals ended."""
    return [touch.time_s for touch in replay.contacts] + [goal.end_s for goal in replay.goals if goal.failed]


def in_words(event: Mapping[str, object]) -> str:
    """Return an event as one line, without its time; its goal, if any, counted from 1."""
    short = {k: v for k, v in event.items() if k not in ("name", "time_s") and isinstance(v, str | int)}
    counted = {k: v + 1 if k == "goal" and isinstance(v, int) else v for k, v in short.items()}
    return ", ".join([str(event["name"]), *(f"{key} {value}" for key, value in counted.items())])


def _panels(gui: GuiApi, replay: Replay) -> list[TimeLinePanel | ErrorPanel | CameraPanel | JointsPanel]:
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
    if any(replay.joints.values()):
        with gui.add_folder("Joints"):
            found += add_joints(gui, replay).values()
    return found
