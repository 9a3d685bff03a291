"""A page that does not answer any more is missed once; a slow one, one that is being built, or that has gone is not."""

import threading
import time
from contextlib import contextmanager

import pytest

from trocar.view.pulse import EVERY_S, LIMIT_S, LOOK_S, SLOWER, Pulse

pytestmark = pytest.mark.realtime
KEPT = 4
"""Fewer answers than in use make a page that is built, so that these tests wait less for it."""
SPARE_S = 4 * LOOK_S
BUILT_S = KEPT * EVERY_S + 2 * SPARE_S


@pytest.fixture(autouse=True)
def _built_sooner(monkeypatch):
    monkeypatch.setattr("trocar.view.pulse.KEPT", KEPT)


class Page:
    """A page as viser has it, which answers after some time, or once it is awake."""

    def __init__(self, late_s=0.0):
        self.local_storage, self.late_s, self.asked = self, late_s, 0
        self.awake, self.error = threading.Event(), None
        self.awake.set()

    def get_item(self, key):
        self.asked += 1
        time.sleep(self.late_s)
        self.awake.wait()
        if self.error:
            raise self.error


@contextmanager
def pulse_of(page):
    missed, holder = [], [page]
    pulse = Pulse(lambda: holder[0], lambda: missed.append(time.monotonic()))
    yield pulse, missed, holder
    page.awake.set()
    pulse.end()


def test_a_page_that_stops_to_answer_is_missed_once_until_it_has_answered():
    page = Page()
    with pulse_of(page) as (pulse, missed, _):
        time.sleep(BUILT_S)
        assert pulse.limit_s == LIMIT_S and not missed
        page.awake.clear()
        began = time.monotonic()
        time.sleep(EVERY_S + LIMIT_S + SPARE_S + 1.0)
        assert len(missed) == 1 and pulse.silent is page
        assert LIMIT_S - SPARE_S < missed[0] - began < EVERY_S + LIMIT_S + SPARE_S
        page.awake.set()
        time.sleep(SPARE_S)
        assert pulse.silent is None and pulse.limit_s == SLOWER * LIMIT_S, "it may only have been slow"
        pulse.limit_s = LIMIT_S
        page.awake.clear()
        time.sleep(EVERY_S + LIMIT_S + SPARE_S)
        assert len(missed) == 2


def test_a_slow_page_has_more_time():
    page = Page(late_s=0.5)
    with pulse_of(page) as (pulse, missed, _):
        time.sleep(BUILT_S + KEPT * page.late_s)
        assert pulse.limit_s == pytest.approx(SLOWER * page.late_s, abs=SLOWER * 2 * LOOK_S)
        page.late_s = LIMIT_S + 0.4
        time.sleep(EVERY_S + page.late_s + SPARE_S)
        assert not missed


def test_a_page_that_is_being_built_is_not_missed():
    page = Page()
    with pulse_of(page) as (_, missed, _):
        time.sleep(2 * EVERY_S + SPARE_S)
        page.awake.clear()
        time.sleep(LIMIT_S + 2 * EVERY_S)
        assert page.asked and not missed


def test_a_page_that_has_gone_is_not_missed():
    page = Page()
    with pulse_of(page) as (_, missed, holder):
        time.sleep(BUILT_S)
        page.awake.clear()
        time.sleep(EVERY_S + SPARE_S)
        page.error, holder[0] = RuntimeError("it has gone"), None
        page.awake.set()
        time.sleep(LIMIT_S + 2 * EVERY_S)
        assert not missed


def test_a_browser_that_keeps_no_values_has_answered():
    page = Page()
    page.error = RuntimeError("the browser keeps nothing")
    with pulse_of(page) as (pulse, missed, _):
        time.sleep(BUILT_S)
        assert pulse.limit_s == LIMIT_S and not missed
