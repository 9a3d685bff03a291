"""A live page with controls: what a person does in the browser arrives as wishes."""

import math
import time

import numpy as np
import pytest

pytest.importorskip("viser")
from browser import NAMES, browser, find_chromium
from live_scene import REPLAY, MadeUpScene, console_moment, until

from trocar.arms import ARMS, fk
from trocar.geometry import SE3
from trocar.view.console_view import ConsoleView, Ghost
from trocar.view.pulse import EVERY_S
from trocar.view.wishes import Level, Wish

pytestmark = pytest.mark.skipif(
    find_chromium() is None, reason=f"no Chromium found ({', '.join(NAMES)}): the page is not looked at"
)
SIZE = (1400, 900)
COARSE = 0.2
"""Pixels drawn per pixel of the page, on each axis, where no picture is judged: drawing takes most of the time."""
HANDLE = np.array([250, 46, 106])
"""The colour of a handle's first axis."""


class Open:
    """A page, the browser that shows it, and what was said there."""

    def __init__(self):
        self.said = []
        self.view = ConsoleView(MadeUpScene(), "made up", console_moment(0), port=0, say=self.said.append)
        self.tick = 100

    def show(self, **standing):
        self.tick += 1
        self.view.show(console_moment(self.tick, **standing))

    def press(self, page, label):
        """Press the button with this label; return the wish that came."""
        self.said.clear()
        page.press(label)
        return until(lambda: self.said and self.said[-1])


@pytest.fixture(scope="module")
def opened():
    opened = Open()
    with browser(*SIZE) as page:
        page.open(f"http://127.0.0.1:{opened.view.port}", COARSE)
        page.until("document.body.innerText.includes('Stop (S)')")
        yield opened, page
    opened.view.close()


@pytest.mark.parametrize(
    ("label", "standing", "wish", "arm"),
    [
        ("Yes, go", {"asks": True}, Wish.YES, ""),
        ("No, not this", {"asks": True, "may_refuse": True}, Wish.NO, ""),
        ("Another goal", {"asks": True, "choices": 2}, Wish.ANOTHER, ""),
        ("Stop", {}, Wish.STOP, ""),
        ("Go on", {"stopped": True}, Wish.GO_ON, ""),
        ("EMERGENCY", {}, Wish.EMERGENCY, ""),
        ("Task done", {"works": True}, Wish.DONE, ""),
        ("Take over", {}, Wish.TAKE, "psm1"),
        ("a third", {"hands": {"psm1": (np.zeros(3), np.array([1.0, 0, 0, 0]))}}, Wish.JAW, "psm1"),
        ("Hand", {"hands": {"psm1": (np.zeros(3), np.array([1.0, 0, 0, 0]))}}, Wish.RETURN, "psm1"),
    ],
)
def test_a_button_is_there_when_it_can_be_wished_for(opened, label, standing, wish, arm):
    opened, page = opened
    words = f"Runs since {opened.tick}"
    opened.show(words=words, **standing)
    page.until(f"document.body.innerText.includes({words!r})")  # all that has changed is on the page, and stays there
    said = opened.press(page, label)
    assert (said.wish, said.arm) == (wish, arm) and abs(time.monotonic() - said.at_s) < 20


def test_the_emergency_stop_has_a_key(opened):
    opened, page = opened
    opened.said.clear()
    page.key("X")
    assert until(lambda: opened.said)[0].wish is Wish.EMERGENCY


def test_a_key_that_is_held_repeats_steps_but_neither_a_yes_nor_jaws(opened):
    """A yes that repeats would be one to the next question too, as soon as it is shown."""
    opened, page = opened
    opened.show(words="In your hands", hands={"psm1": (np.zeros(3), np.array([1.0, 0, 0, 0]))})
    page.until("document.body.innerText.includes('Keys move psm1')")
    opened.said.clear()
    for letter in "UYCS":
        page.key(letter, repeats=4)
    page.key("O", shift=True)
    said = until(lambda: len(opened.said) > 8 and opened.said)
    assert [one.wish for one in said] == [Wish.HOLD] * 5 + [Wish.YES, Wish.JAW, Wish.STOP, Wish.HOLD]
    assert [1e3 * one.value.by_m[2] for one in (said[0], said[-1])] == pytest.approx([1.0, -5.0])


def test_the_key_that_stops_leaves_the_view_where_it_is(opened):
    opened, page = opened
    camera = "(c => [...c.position.toArray(), ...c.quaternion.toArray()])(window.__viserMutable.camera)"
    before, drawn = (
        page.evaluate(camera),
        "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))",
    )
    held = {"key": "s", "code": "KeyS", "windowsVirtualKeyCode": ord("S")}
    opened.said.clear()
    page.call("Input.dispatchKeyEvent", type="keyDown", **held)
    page.evaluate(drawn)
    page.call("Input.dispatchKeyEvent", type="keyUp", **held)
    assert until(lambda: opened.said)[0].wish is Wish.STOP
    np.testing.assert_allclose(page.evaluate(camera), before, atol=1e-9)


def test_keys_count_though_a_menu_was_used_last(opened):
    opened, page = opened
    opened.show(words="Runs")
    page.choose(Level.AUTONOMOUS.value, Level.MOTIONS.value)
    until(lambda: opened.said and opened.said[-1].wish is Wish.LEVEL)
    assert page.evaluate("document.activeElement.tagName") == "INPUT"
    opened.said.clear()
    page.key("X")
    assert until(lambda: opened.said)[0].wish is Wish.EMERGENCY


def test_words_and_levels_are_shown(opened):
    opened, page = opened
    opened.show(words="Waits for your yes: psm1 moves", asks=True, level=Level.MOTIONS)
    page.until("document.body.innerText.includes('Waits for your yes: psm1 moves')")
    page.until(f"[...document.querySelectorAll('input')].some(i => i.value === {Level.MOTIONS.value!r})")


def test_a_handle_that_is_dragged_says_where_it_is_and_when_it_is_let_go():
    opened, width = Open(), 1100
    with browser(width, 700) as page:
        page.open(f"http://127.0.0.1:{opened.view.port}")
        page.until("document.body.innerText.includes('Stop (S)')")
        drag_a_handle(opened, page, width - 560)  # well away from the panel, whose edge may be dragged too
    opened.view.close()


def drag_a_handle(opened, page, width):
    """Drag the first axis of a handle, or its arc, seen in the first ``width`` pixels of a page, and let go."""
    tip = REPLAY().tools["psm1"].p_world_driven_m[opened.tick]
    opened.show(hands={"psm1": (tip, np.array([1.0, 0, 0, 0]))})

    def axis():
        seen = page.picture().astype(int)[:, :width]
        return np.argwhere(np.abs(seen - HANDLE).max(-1) < 14)

    until(lambda: axis().size > 60)
    pixels = axis()
    y, x = pixels[np.argmax(np.abs(pixels - pixels.mean(0)).sum(1))]
    opened.said.clear()
    for step in range(-1, 9):
        kind = "mouseMoved" if step >= 0 else "mousePressed"
        at = {"x": float(x) + 8 * max(0, step), "y": float(y)}
        page.call("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, clickCount=1, **at)
        time.sleep(0.1)
    page.call("Input.dispatchMouseEvent", type="mouseReleased", button="left", clickCount=1, **at)
    said = until(lambda: opened.said and opened.said[-1].wish is Wish.RELEASE and opened.said)
    held = [one for one in said if one.wish is Wish.HOLD]
    assert held and {one.arm for one in said} == {"psm1"}
    last = held[-1].value  # an arrow moves the handle; the arc of the same colour, which the view may favour, turns it
    assert np.linalg.norm(last.position_m - tip) > 1e-3 or abs(last.wxyz[0]) < math.cos(0.05)


@pytest.mark.slow
def test_the_instrument_is_drawn_where_a_motion_would_bring_it_until_that_is_answered():
    opened, arm = Open(), ARMS["psm-classic"]
    q = np.array([0.2, 0.1, 0.12, 0.0, 0.2, 0.1])
    tip_m = REPLAY().tools["psm1"].p_world_driven_m[opened.tick]
    base = SE3.from_parts(translation_m=tip_m - fk(arm, q).translation_m)
    with browser(*SIZE) as page:
        page.open(f"http://127.0.0.1:{opened.view.port}")
        page.until("document.body.innerText.includes('Stop (S)')")

        def seen():
            return page.picture().astype(int)[:, : SIZE[0] - 560]

        def tinted(before):
            """Return how many pixels that were grey have a colour now."""
            return int(((np.ptp(before, axis=-1) < 12) & (np.ptp(seen(), axis=-1) > 30)).sum())

        opened.show(words="Runs again")
        until(lambda: (np.ptp(seen(), axis=-1) > 100).mean() > 0.3, 120.0)  # the scene is there: a red board
        until(lambda: tinted(seen()) == 0, 120.0)  # and has faded in
        before = seen()
        opened.show(words="Waits", asks=True, ghosts={"psm1": Ghost(arm, base, tip_m + np.zeros((2, 3)), q, 0.5)})
        until(lambda: tinted(before) > 12_000, 120.0)
        opened.show(words="Goes")
        until(lambda: tinted(before) < 6_000, 120.0)
    opened.view.close()


def test_a_second_browser_may_watch_and_stop_but_not_command(opened):
    opened, _ = opened
    opened.show()
    opened.said.clear()
    with browser(900, 700) as second:
        second.open(f"http://127.0.0.1:{opened.view.port}", COARSE)
        second.until("document.body.innerText.includes('Stop (S)')")
        second.press("Take over")
        second.until("document.body.innerText.includes('Another page holds the controls')")
        assert not opened.said
        assert opened.press(second, "Stop").wish is Wish.STOP
        opened.said.clear()
    time.sleep(1.0)
    assert not opened.said, "a page that only watched is not missed"


@pytest.mark.parametrize("pixels", [1, 3])
def test_on_a_telephone_the_scene_ends_where_the_panel_begins(opened, pixels):
    """Telephones have several pixels of the screen for each of the page's."""
    (opened, _), height = opened, 844
    with browser(390, height) as phone:
        given = {"width": 390, "height": height, "deviceScaleFactor": pixels, "mobile": True}
        phone.call("Emulation.setDeviceMetricsOverride", **given)
        phone.open(f"http://127.0.0.1:{opened.view.port}")
        phone.until("document.body.innerText.includes('Stop (S)')")
        bottom = "document.querySelector('canvas').getBoundingClientRect().bottom"
        panel = """document.querySelector('.mantine-Paper-root[style*="position: fixed"]').getBoundingClientRect()"""
        phone.until(f"{bottom} < {0.45 * height} && {bottom} > {0.4 * height} && {panel}.bottom > {height - 1}")
        phone.until(f"{panel}.top > {bottom} - 1 && {panel}.width > 389")


def test_the_page_that_held_the_controls_is_missed():
    opened = Open()
    with browser(900, 700) as page:
        page.open(f"http://127.0.0.1:{opened.view.port}", COARSE)
        page.until("document.body.innerText.includes('Stop (S)')")
        opened.said.clear()
    assert until(lambda: opened.said)[-1].wish is Wish.LEFT
    opened.view.close()


@pytest.mark.realtime
def test_a_page_that_is_frozen_is_missed_once_and_used_again_afterwards():
    opened = Open()
    with browser(400, 300) as page:
        page.open(f"http://127.0.0.1:{opened.view.port}", COARSE)
        page.until("document.body.innerText.includes('Stop (S)')")
        until(lambda: opened.view.pulse.limit_s < math.inf, 60.0)
        for _ in range(50):
            opened.show()
            opened.tick -= 1
            time.sleep(0.1)
        assert not opened.said, "a page that is slow, and alive, is not missed"
        with page.frozen():
            began, limit_s = time.monotonic(), opened.view.pulse.limit_s + 2 * EVERY_S  # long, if it was slow until now
            until(lambda: opened.said, limit_s)
            assert time.monotonic() - began <= limit_s
            time.sleep(2.0)
            assert [one.wish for one in opened.said] == [Wish.LEFT]
        until(lambda: opened.view.pulse.silent is None, 60.0)
        assert opened.press(page, "Stop").wish is Wish.STOP
    opened.view.close()
