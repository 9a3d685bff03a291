"""A replay opened from its file in a headless Chromium draws, moves, goes back, and makes no network request."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from made_up_replay import made_up_replay

pytest.importorskip("viser")
from browser import NAMES, THUMB, browser, find_chromium

from trocar.view.replay import END_S, write_replay
from trocar.view.stage import ARMS
from trocar.view.trial_view import TrialView

pytestmark = pytest.mark.skipif(
    find_chromium() is None, reason=f"no Chromium found ({', '.join(NAMES)}): the page is not looked at"
)
SIZE = (800, 520)
LENGTH_S = 8.0
WITHIN = re.compile(r"(file|data|blob):")


@pytest.fixture(scope="module")
def replay():
    return made_up_replay(LENGTH_S)


@pytest.fixture(scope="module")
def page(replay, tmp_path_factory):
    path = write_replay(replay, tmp_path_factory.mktemp("page") / "replay.html")
    with browser(*SIZE) as page:
        page.open(path.as_uri())
        began_s = page.time_s()
        page.until(f"{THUMB}.getAttribute('aria-valuenow') > {began_s + 0.3}")  # it plays by itself
        yield page


@pytest.fixture(scope="module")
def pictures(page):
    """What is seen at three moments, and at the first of them again."""
    return {share: (page.seek(share), page.scene()) for share in (0.15, 0.45, 0.8)} | {
        "again": (page.seek(0.15), page.scene())
    }


def changed(a, b):
    """Return the share of pixels that differ so that one sees it."""
    return float((np.abs(a.astype(int) - b.astype(int)).max(-1) > 24).mean())


def test_it_plays_by_itself_and_its_slider_goes_where_one_clicks(pictures):
    for share in (0.15, 0.45, 0.8):
        assert_allclose(pictures[share][0], share * (LENGTH_S + END_S), atol=0.15)


def test_it_begins_at_the_time_in_its_address_and_goes_where_that_changes(replay, tmp_path):
    path = write_replay(replay, tmp_path / "replay.html")
    with browser(*SIZE) as page:
        page.call("Page.navigate", url=f"{path.as_uri()}#t=5.25")
        page.until(f"{THUMB} && {THUMB}.getAttribute('aria-valuenow') > 5.2")
        assert_allclose(page.time_s(), 5.25, atol=0.2)
        page.until(f"{THUMB}.getAttribute('aria-valuenow') > 5.3")  # it plays on
        page.evaluate("location.hash = '#t=2'")
        page.until(f"Math.abs({THUMB}.getAttribute('aria-valuenow') - 2) < 0.2")
        page.evaluate("location.hash = '#t=99'")
        page.until(f"{THUMB}.getAttribute('aria-valuenow') > {LENGTH_S}")
        assert page.errors == []


SHADE = "document.documentElement.getAttribute('data-mantine-color-scheme')"


def shaded(page, address, shade):
    """Return what is seen of a scene in a browser that prefers light or dark."""
    page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": shade}])
    page.open(address)
    page.until(f"{SHADE} === {shade!r}")
    return page.scene(20.0)


def test_it_is_light_or_dark_as_the_browser_prefers(replay, tmp_path):
    path = write_replay(replay, tmp_path / "replay.html")
    colour = "getComputedStyle(document.querySelector('#trocar h1')).color"
    with browser(*SIZE) as page:
        corners = {}
        for shade, ink in (("dark", "rgb(230, 233, 236)"), ("light", "rgb(34, 38, 43)")):
            corners[shade] = shaded(page, path.as_uri(), shade)[:20, :20].mean()
            assert page.evaluate(colour) == ink
        assert corners["light"] > 220 and corners["dark"] < 110
        assert page.errors == []


def test_three_moments_show_a_scene_each_and_differ(pictures):
    shown = [pictures[share][1] for share in (0.15, 0.45, 0.8)]
    for picture in shown:
        assert picture.std() > 30  # not blank
        assert len(np.unique(picture.reshape(-1, 3) // 16, axis=0)) > 60  # shaded
    for a, b in ((0, 1), (1, 2), (0, 2)):
        assert changed(shown[a], shown[b]) > 0.01


def test_going_back_shows_what_was_there(pictures):
    assert changed(pictures[0.15][1], pictures["again"][1]) < 0.005


@pytest.mark.parametrize("colour", ARMS[:2], ids=["psm1", "psm2"])
def test_both_arms_paths_are_seen(pictures, colour):
    """Colours are toned by the browser: their hue is looked for, in the scene above the legend."""
    picture = pictures[0.45][1][:380].astype(float)
    unit = picture - picture.mean(-1, keepdims=True)
    wanted = np.array(colour, float) - np.mean(colour)
    likeness = unit @ wanted / np.maximum(np.linalg.norm(unit, axis=-1), 1e-9) / np.linalg.norm(wanted)
    strong = np.linalg.norm(unit, axis=-1) > 60
    assert ((likeness > 0.95) & strong).sum() > 40


def test_title_and_legend_stand_over_the_scene_and_catch_no_clicks(page, replay):
    text = page.evaluate("document.querySelector('#trocar').innerText")
    assert replay.title in text
    assert "tip, planned" in text
    assert page.evaluate("document.title") == replay.title
    left, top, right, bottom, catches = page.evaluate(
        "(() => { const r = document.querySelector('#trocar').getBoundingClientRect();"
        " const hit = document.elementFromPoint(r.left + 20, r.top + 20);"
        " return [r.left, r.top, r.right, r.bottom, hit.closest('#trocar') !== null]})()"
    )
    assert 0 <= left < right <= SIZE[0]
    assert SIZE[1] * 2 / 3 <= top < bottom <= SIZE[1] - 38  # above the player's bar
    assert not catches


def test_no_network_is_asked_for_anything(page, pictures):
    assert page.requests
    assert [address for address in page.requests if not WITHIN.match(address)] == []


def test_the_browser_would_not_let_it(page):
    refused = page.evaluate("fetch('http://127.0.0.1:9/').then(() => 'fetched', error => 'refused')")
    assert refused == "refused"
    assert [address for address in page.requests if not WITHIN.match(address)] == []
    page.errors.clear()


def test_nothing_went_wrong_on_the_page(page, pictures):
    assert page.errors == []


def test_the_live_view_draws_the_same_scene_with_its_panels(replay):
    view = TrialView(replay, 0)
    try:
        view.show(4.0)
        with browser(1100, 620) as page:
            page.open(f"http://127.0.0.1:{view.port}", fineness=0.5)
            page.until("document.body.innerText.includes('true - desired')")
            page.until("document.querySelectorAll('.uplot').length > 0")
            before = page.scene()
            view.show(6.0)
            assert before.std() > 30
            assert changed(before, page.scene()) > 0.01
            for words in (
                "psm1",
                "Time line",
                "Tips, driven from planned",
                "whole paths",
                "Camera: overhead",
                "jump to",
            ):
                assert page.evaluate(f"document.body.innerText.includes('{words}')")
            outside = re.compile(rf"(http|ws)://127\.0\.0\.1:{view.port}|data:|blob:")
            assert [address for address in page.requests if not outside.match(address)] == []
            assert page.errors == []
            assert shaded(page, f"http://127.0.0.1:{view.port}", "dark")[0, :4].mean() < 110
    finally:
        view.close()
