"""A live page with controls, and the console's state that it shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.geometry import SE3
from trocar.view import trial_view
from trocar.view.arm_keys import JAWS, ArmKeys
from trocar.view.instrument import Instrument
from trocar.view.live import GOOD, LAST, LiveView, Moment, Picture, Scene, box, table
from trocar.view.pulse import Pulse
from trocar.view.stage import BOLD_PX, Rgb, add_line, css
from trocar.view.wishes import ANSWERS, KEYS, OF_ANYBODY, Held, Level, Said, Step, Wish

GHOST: Rgb = (255, 140, 0)
PATH: Rgb = (255, 255, 255)
CLEAR = 0.35
"""Opacity of the instrument at the end of a motion that waits for confirmation."""
HANDLE_M = 0.018
"""Length of the axes of a handle."""
CONTROLS = 0.5
"""Place of the controls in the panel, above clock and arms."""
SPEEDS = {**trial_view.SPEEDS, "as fast as it can": 0.0}
"""Seconds of the cell's clock per second; 0: no limit."""
STEP_S = 0.1


class Ghost(NamedTuple):
    """A motion that waits for confirmation, or the way of a goal.

    Attributes:
        arm: model of the arm that moves.
        T_world_base: registered pose of that arm's base.
        path_m: (n, 3) path of its tip in the world.
        q: (6,) joints at its end; before a goal, where the arm is.
        jaw_rad: opening of the jaws now.
    """

    arm: ArmModel
    T_world_base: SE3
    path_m: NDArray[np.float64]
    q: NDArray[np.float64]
    jaw_rad: float


@dataclass(frozen=True, eq=False)
class Standing:
    """The state of a console.

    Attributes:
        words: the state in a sentence.
        colour: of the sentence.
        asks: whether a motion or a goal waits for confirmation.
        question: number of the question about it; the page's yes names it.
        may_refuse: whether the motion can be refused.
        choices: number of goals among which the person may choose; 1: there is no choice.
        stopped: whether the arms are stopped.
        level: what a script needs confirmation for.
        speed: of the simulator's clock; None on real arms.
        works: whether the person does the whole task, rather than a script.
        idle: whether no trial runs.
        methods: with which the person may begin a trial; none while one runs.
        ghosts: motions that wait for confirmation, or the way of a goal, by arm.
        paths: of the motions that scripts run, by arm: points (n, 3) m in the world.
        hands: arms that the person moves: position (3,) in m and quaternion w, x, y, z of the tip, or None while the
            tip follows an input.
    """

    words: str
    colour: Rgb = GOOD
    asks: bool = False
    question: int = 0
    may_refuse: bool = False
    choices: int = 1
    stopped: bool = False
    level: Level = Level.AUTONOMOUS
    speed: float | None = 1.0
    works: bool = False
    idle: bool = False
    methods: tuple[str, ...] = ()
    ghosts: Mapping[str, Ghost] = field(default_factory=dict)
    paths: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    hands: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]] | None] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ConsoleMoment(Moment):
    """The state of a cell and its console at one time.

    Attributes:
        standing: the console's state.
        images: new ones.
        scene: new scene of the cell; None: unchanged.
        flaws: sizes of the cell's flaws in words, by name.
    """

    standing: Standing = field(default_factory=lambda: Standing(""))
    images: tuple[Picture, ...] = ()
    scene: Scene | None = None
    flaws: Mapping[str, str] = field(default_factory=dict)


class ConsoleView(LiveView):
    """A live page with controls.

    If several browsers have it open, the one that opened it first has the controls; each can stop the arms.

    Args:
        scene: of the cell.
        title: of the page.
        moment: the first one.
        port: as in ``LiveView``.
        say: called with each wish, from the server's threads.

    Attributes:
        pulse: watches the page that has the controls; if it stops answering, it counts as gone.
    """

    def __init__(self, scene: Scene, title: str, moment: ConsoleMoment, port: int, say: Callable[[Said], None]):
        self._say = say
        self._ghosts: dict[str, tuple[Ghost, Any, Instrument]] = {}
        self._speeds = dict(SPEEDS)
        if moment.standing.speed not in (None, *SPEEDS.values()):
            self._speeds[f"x {moment.standing.speed:g}"] = moment.standing.speed
        self._handles: dict[str, Any] = {}
        self._paths: dict[str, tuple[NDArray[np.float64], Any]] = {}
        self._question = 0
        self._flaws_shown: Mapping[str, str] | None = None
        super().__init__(scene, title, moment, port)
        self.pulse = Pulse(lambda: self.server.get_clients().get(self._holder), lambda: say(Said(Wish.LEFT)))
        self.server.on_client_disconnect(self._left)

    def close(self) -> None:
        """Stop serving."""
        self.pulse.end()
        super().close()

    def show(self, moment: Moment) -> None:
        """Show the next moment, with the console's state."""
        assert isinstance(moment, ConsoleMoment)
        if moment.scene is not None:
            self.begin(moment.scene)
        with self.server.atomic():
            super().show(moment)
            self._show_standing(moment.standing)
            if moment.flaws != self._flaws_shown:  # they change once a trial
                self._flaws_shown = moment.flaws
                self._flaws.content = box(table(moment.flaws, 220))
        for picture in moment.images:
            self.show_image(picture)

    def _add_panels(self, replay: Any) -> None:
        super()._add_panels(replay)
        gui = self.server.gui
        with gui.add_folder("Console", order=CONTROLS):
            self._words = gui.add_html("")
            self._yes = self._add_button("Yes, go", "Y", Wish.YES, color="green", visible=False)
            self._no = self._add_button("No, not this", "V", Wish.NO, visible=False)
            self._another = self._add_button("Another goal", "N", Wish.ANOTHER, visible=False)
            self._stop = self._add_button("Stop", "S", Wish.STOP, color="orange")
            self._go_on = self._add_button("Go on", "G", Wish.GO_ON, color="green", visible=False)
            self._add_button("EMERGENCY STOP", "X", Wish.EMERGENCY, color="red")
            self._done = gui.add_button("Task done: end the trial", visible=False)
            self._method: Any = gui.add_dropdown("method", ("",), visible=False)
            self._begin = gui.add_button("Begin a trial", color="green", visible=False)
            levels = {level.value: level for level in Level}
            clocks = {"pause": (Wish.PAUSE, True), "run": (Wish.PAUSE, False), "step .1 s": (Wish.STEP, STEP_S)}
            self._level = level = gui.add_dropdown("yes needed for", tuple(levels))
            self._speed = speed = gui.add_dropdown("speed", tuple(self._speeds))
            self._turns = clock = gui.add_button_group("clock", tuple(clocks))
        self._pass_on(self._done.on_click, lambda _: (Wish.DONE, None))
        self._pass_on(self._begin.on_click, lambda _: (Wish.BEGIN, self._method.value))
        self._pass_on(clock.on_click, lambda _: clocks[clock.value])
        self._pass_on(level.on_update, lambda _: (Wish.LEVEL, levels[level.value]))
        self._pass_on(speed.on_update, lambda _: (Wish.SPEED, self._speeds[speed.value]))
        with gui.add_folder("Arms", order=CONTROLS):
            self._arms = {arm: self._add_arm(arm) for arm in replay.tools}
            self._keys = ArmKeys(
                gui,
                self._arms,
                self._may,
                lambda arm, by_m: self._say(Said(Wish.HOLD, arm, Step(by_m), source=KEYS)),
                lambda arm, share: self._say(Said(Wish.JAW, arm, share)),
            )
        with gui.add_folder("Flaws of this cell", order=LAST, expand_by_default=False):
            self._flaws = gui.add_html("")

    def _add_button(self, label: str, key: Any, wish: Wish, **how: Any) -> Any:
        """Add a button with a hotkey; an answer concerns only what the page shows, not a later question."""

        def made(_: Any) -> tuple[Wish, Any]:
            return wish, self._question if wish in ANSWERS else None

        button = self.server.gui.add_button(f"{label} ({key})", **how)
        self._pass_on(button.on_click, made)
        self._pass_on(self.server.gui.add_command(label.capitalize(), hotkey=key).on_trigger, made)
        return button

    def _add_arm(self, arm: str) -> tuple[Any, Any, Any]:
        """Add the controls of an arm: take or return it, close its jaws, open them."""
        gui = self.server.gui
        take = gui.add_button(f"Take over {arm}")
        back = gui.add_button(f"Hand {arm} back", visible=False)
        jaws = gui.add_button_group(f"jaws of {arm}", tuple(JAWS), visible=False)
        self._pass_on(take.on_click, lambda _: (Wish.TAKE, None), arm)
        self._pass_on(back.on_click, lambda _: (Wish.RETURN, None), arm)
        self._pass_on(jaws.on_click, lambda _: (Wish.JAW, JAWS[jaws.value]), arm)
        return take, back, jaws

    def _pass_on(self, attach: Callable[[Any], Any], made: Callable[[Any], tuple[Wish, Any]], arm: str = "") -> None:
        """Pass on a wish, and its value, whenever something happens on the page.

        viser calls an async function at once and in the order of what happened. It would call another one from any of
        its threads, too late: by then, a later wish may have come first, or the next moment set the value back.

        Args:
            attach: of viser's handle, such as its ``on_click``.
            made: returns the wish and its value; called with viser's event.
            arm: the arm that it concerns, if any.
        """

        async def happened(event: Any) -> None:
            self._wish(event, *made(event), arm)

        attach(happened)

    def _wish(self, event: Any, wish: Wish, value: Any = None, arm: str = "") -> None:
        """Pass on a wish of the browser that has the controls, or anybody's stop; ignore what this program sets."""
        if event.client is not None and (wish in OF_ANYBODY or self._may(event)):
            self._say(Said(wish, arm, value))

    def _may(self, event: Any) -> bool:
        """Return whether an event's browser has the controls; else tell it."""
        if event.client.client_id == self._holder:
            return True
        event.client.add_notification("Another page holds the controls", "It was opened first.")
        return False

    @property
    def _holder(self) -> int:
        return min(self.server.get_clients(), default=-1)

    def _left(self, client: Any) -> None:
        """Report that the page with the controls (the lowest id) has gone, unless its silence was reported already."""
        held = client.client_id < min(self.server.get_clients(), default=client.client_id + 1)
        if held and client is not self.pulse.silent:
            self._say(Said(Wish.LEFT))

    def _show_standing(self, now: Standing) -> None:
        self._question = now.question
        self._words.content = box(
            f'<div style="border-left:6px solid {css(now.colour)};padding:4px 10px">{escape(now.words)}</div>'
        )
        self._yes.visible, self._done.visible = now.asks, now.works
        self._no.visible = now.asks and now.may_refuse
        self._another.visible = now.asks and now.choices > 1
        self._stop.visible, self._go_on.visible = not now.stopped, now.stopped
        self._method.visible = self._begin.visible = bool(now.methods)
        if now.methods and self._method.options != now.methods:
            self._method.options = now.methods
        self._level.visible = not now.works  # no script asks
        self._level.value = now.level.value
        self._speed.visible = self._turns.visible = now.speed is not None
        self._speed.value = next((name for name, speed in self._speeds.items() if speed == now.speed), "x 1")
        self._keys.show(now.hands)
        for arm, (take, back, jaws) in self._arms.items():
            held = arm in now.hands
            busy = not now.works and not now.idle  # with a script
            take.visible, back.visible, jaws.visible = busy and not held, busy and held, held
            self._show_handle(arm, now)
            self._show_ghost(arm, now.ghosts.get(arm))
            self._show_path(arm, now.paths.get(arm))

    def _show_handle(self, arm: str, now: Standing) -> None:
        """Move an arm's handle to its tip unless the tip follows an input; remove it once the arm is returned."""
        handle = self._handles.get(arm)
        if arm not in now.hands:
            if handle is not None:
                self._handles.pop(arm).remove()
            return
        where = now.hands[arm]
        if where is None:
            return
        if handle is None:
            handle = self.server.scene.add_transform_controls(f"/handles/{arm}", HANDLE_M, depth_test=False)
            self._pass_on(handle.on_update, moved, arm)
            self._handles[arm] = handle
        handle.position, handle.wxyz = where

    def _show_path(self, arm: str, path_m: NDArray[np.float64] | None) -> None:
        """Draw the path of the motion that an arm runs; remove that of an earlier one."""
        before_m, line = self._paths.get(arm, (None, None))
        if path_m is before_m or (path_m is not None and before_m is not None and np.array_equal(path_m, before_m)):
            return
        if line is not None:
            self._paths.pop(arm)[1].remove()
        if path_m is not None:
            line = add_line(self.server.scene, f"/paths/{arm}", path_m.astype(np.float32), PATH, BOLD_PX)
            self._paths[arm] = path_m, line

    def _show_ghost(self, arm: str, ghost: Ghost | None) -> None:
        """Draw a motion's path and the instrument at its end; remove those of an earlier motion."""
        shown = self._ghosts.get(arm)
        if shown is not None and ghost is not None and np.array_equal(shown[0].path_m, ghost.path_m):
            return
        if shown is not None:
            for drawn in self._ghosts.pop(arm)[1:]:
                drawn.remove()
        if ghost is None:
            return
        scene, name = self.server.scene, f"/ghosts/{arm}"
        line = add_line(scene, name, ghost.path_m.astype(np.float32), GHOST, BOLD_PX)
        there = Instrument(scene, f"{name} there", ghost.arm, GHOST, GHOST, opacity=CLEAR, cast_shadow=False)
        there.show(ghost.T_world_base, ghost.q, ghost.jaw_rad)
        self._ghosts[arm] = ghost, line, there


def moved(event: Any) -> tuple[Wish, Held | None]:
    """Return what an event of a handle wishes: the tip is held at a pose, or let go."""
    if event.phase == "end":
        return Wish.RELEASE, None
    return Wish.HOLD, Held(np.array(event.target.position), np.array(event.target.wxyz))
