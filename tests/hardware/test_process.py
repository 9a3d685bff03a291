"""The process of the loop, here without its own process: what it does first, and what it leaves behind."""

import importlib

import pytest

from driven import ARM, PAPER
from echo_arms import EchoArm
from trocar.hardware import process
from trocar.hardware.arm import DrivenArm, LoopSettings

SETTINGS = LoopSettings(priority=0)


class Told:
    """The scripts' end of a connection."""

    def __init__(self):
        self.messages = []

    def send(self, message):
        self.messages.append(message)


class Noting(EchoArm):
    """An arm that notes when it is asked what its controller holds, and when it is closed."""

    def __init__(self, notes):
        super().__init__()
        self.notes = notes

    def commanded(self):
        self.notes.append("commanded")
        return super().commanded()

    def close(self):
        self.notes.append("close")


class Mistaken(Noting):
    """An arm whose driver has a mistake where the loop expects none."""

    @property
    def behind(self):
        raise KeyError("a mistake in a driver")


@pytest.fixture
def serve(monkeypatch):
    """Return a function that serves one arm and ticks once; this process keeps its signals."""
    monkeypatch.setattr(process.signal, "signal", lambda *_: None)
    monkeypatch.setattr(process, "_tick_until_closed", lambda loop, *_: loop.tick())

    def serve(arm):
        told = Told()
        process.serve({"a": DrivenArm(ARM, PAPER)}, lambda name: arm, SETTINGS, None, told)
        return told.messages

    return serve


def test_what_takes_long_to_import_is_there_before_an_arm_is_asked_what_it_holds(serve, monkeypatch):
    notes, load = [], importlib.import_module

    def noted(name, *more):
        notes.extend([name] if name == "scipy.interpolate" else [])  # which imports others
        return load(name, *more)

    monkeypatch.setattr(importlib, "import_module", noted)
    assert serve(Noting(notes)) == [None]
    assert notes == ["scipy.interpolate", "commanded", "close"]


def test_a_mistake_in_a_driver_that_ends_the_loop_leaves_no_connection_open(serve):
    notes = []
    with pytest.raises(KeyError, match="a mistake in a driver"):
        serve(Mistaken(notes))
    assert notes == ["commanded", "close"]


def test_an_arm_is_closed_once(serve, monkeypatch):
    notes = []
    monkeypatch.setattr(process, "_tick_until_closed", lambda loop, *_: loop.close())
    serve(Noting(notes))
    assert notes == ["commanded", "close"]
