"""Whether the listener was held up is its own affair: nothing that a robot sends, or when, can look like it."""

import gc
from types import SimpleNamespace

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from memory_bus import MemoryBus
from trocar.crtk import listening
from trocar.crtk.bus import stamped
from trocar.crtk.listening import Listener, listen
from trocar.crtk.messages import Image
from trocar.lab import load_station
from trocar.lab.topics import Topics

STATION, TOPICS = load_station("peg-transfer"), Topics()


class Machine:
    """A machine on which each look costs some work, and each sleep is too long by something else."""

    def __init__(self, work_s, late_s):
        self.now_s, self.worked_s, self._work_s, self._late_s = 1.7e9, 0.0, work_s, late_s
        self.collects = []

    def time(self):
        return self.now_s

    monotonic = time

    def process_time(self):
        return self.worked_s

    def sleep(self, seconds):
        self.collects.append(gc.isenabled())
        self.now_s += seconds + self._late_s

    def take(self):
        self.now_s += self._work_s
        self.worked_s += self._work_s
        return []


@pytest.fixture
def heard_on(monkeypatch):
    def heard_on(machine):
        listener = Listener(MemoryBus(), STATION, TOPICS, ["psm1"])
        source = next(iter(listener._sources.values()))
        monkeypatch.setattr(source, "take", machine.take)
        clocks = {name: getattr(machine, name) for name in ("time", "monotonic", "process_time", "sleep")}
        monkeypatch.setattr(listening, "time", SimpleNamespace(**clocks))
        return listen(listener, 2.0)

    return heard_on


def test_its_own_work_does_not_hold_the_listener_up_but_messages_are_then_found_late(heard_on):
    heard = heard_on(Machine(work_s=0.06, late_s=0.0))
    assert heard.pause_s == pytest.approx(0.0, abs=1e-6)
    assert max(list(heard.blind_s.values())[1:]) == pytest.approx(0.061, abs=1e-6)


def test_others_who_need_the_machine_hold_it_up(heard_on):
    assert heard_on(Machine(work_s=0.004, late_s=0.04)).pause_s == pytest.approx(0.04, abs=1e-6)


def test_what_has_been_heard_is_not_looked_through_for_garbage_meanwhile(heard_on):
    machine = Machine(work_s=0.004, late_s=0.0)
    heard_on(machine)
    assert not any(machine.collects) and gc.isenabled()


def test_images_are_kept_without_their_pixels_which_would_fill_the_memory():
    bus = MemoryBus()
    listener, topic = Listener(bus, STATION, TOPICS, [], ["overhead"]), "/overhead/color/image_raw"
    sent = Image(stamped(), 2, 3, "rgb8", 0, 9, bytes(18))
    bus.publisher(topic, Image).send(sent)
    listener.take(1.7e9)
    ((_, kept),) = listener.heard().messages[topic]
    assert (kept.header, kept.height, kept.width, kept.encoding, kept.data) == (sent.header, 2, 3, "rgb8", b"")
    assert len(sent.data) == 18, "other readers of the message still have them"
