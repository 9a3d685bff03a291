"""Ctrl-C in a running cell: whatever a script does, it ends soon, and the line that let no time pass is named."""

import _thread
import logging
import signal
import threading
import time
from types import SimpleNamespace

import pytest
import trio

from simulated import ideal_laboratory, standing
from trocar.sim import watchdog


@pytest.fixture
def laboratory():
    return ideal_laboratory(standing(0))


class Looks(threading.Event):
    """What the watchdog waits on between two looks; counts them from when Ctrl-C was pressed."""

    since_pressed = 0

    def wait(self, timeout=None):
        assert timeout == watchdog.LOOK_S
        Looks.since_pressed += 1
        return super().wait(timeout)


@pytest.fixture
def ctrl_c(monkeypatch):
    """Press Ctrl-C a moment after the script has begun."""
    timers, threads = [], {"Thread": threading.Thread, "get_ident": threading.get_ident}
    monkeypatch.setattr(watchdog, "threading", SimpleNamespace(Event=Looks, **threads))

    def pressed():
        Looks.since_pressed = 0
        _thread.interrupt_main()

    def press():
        timers.append(threading.Timer(0.3, pressed))
        timers[-1].start()

    yield press
    for timer in timers:
        timer.cancel()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_script_that_waits_is_ended_at_a_tick(laboratory, ctrl_c):
    cleaned = []

    async def waits(cell):
        ctrl_c()
        try:
            await trio.sleep_forever()
        finally:
            cleaned.append(cell)

    with pytest.raises(KeyboardInterrupt) as stop:
        laboratory.run(waits, 1e6)
    assert cleaned and not stop.value.args


@pytest.mark.parametrize("times", [1, 2])
def test_a_script_that_loops_is_ended_even_if_something_swallows_the_interruption(laboratory, ctrl_c, times):
    swallowed = []

    async def loops(cell):
        ctrl_c()
        for _ in range(times):
            try:
                while True:
                    pass
            except KeyboardInterrupt:
                swallowed.append(cell)
        while True:
            pass

    with pytest.raises(KeyboardInterrupt, match=r"test_watchdog\.py, line \d+, which let no time pass"):
        laboratory.run(loops, 1e6)
    assert len(swallowed) == times
    looked_s = Looks.since_pressed * watchdog.LOOK_S  # a busy machine makes looks late, not many
    assert looked_s <= watchdog.PATIENCE_S + (times + 2) * watchdog.LOOK_S <= 1.5
    assert all(laboratory.driver.idle(arm) for arm in ("psm1", "psm2"))


def test_a_script_that_lets_no_time_pass_is_named_in_a_warning(laboratory, monkeypatch, caplog):
    monkeypatch.setattr(watchdog, "WARNING_S", 0.5)

    async def computes(cell):
        del cell
        begin = time.monotonic()
        while not caplog.records and time.monotonic() - begin < 30:
            time.sleep(0.01)

    with caplog.at_level(logging.WARNING, "trocar"):
        assert laboratory.run(computes, 1.0)
    (record,) = caplog.records
    assert "test_watchdog.py, line" in record.getMessage()


def test_a_script_is_not_blamed_for_an_image_that_takes_long_to_render(laboratory, monkeypatch, caplog):
    monkeypatch.setattr(watchdog, "WARNING_S", 0.5)
    camera = laboratory.cell.cameras["overhead"]
    image, looked = camera.renderer.image, []

    def slow(*given):
        begin = time.monotonic()
        while not caplog.records and time.monotonic() - begin < 3 * watchdog.WARNING_S:
            time.sleep(0.01)
        looked.append(image(*given))
        return looked[-1]

    monkeypatch.setattr(camera.renderer, "image", slow)
    with caplog.at_level(logging.WARNING, "trocar"):
        assert laboratory.run(lambda cell: cell.cameras["overhead"].capture(), 1.0)
    assert len(looked) == 1 and not caplog.records and not camera.rendering


def test_a_program_is_not_blamed_for_the_script_that_it_runs(laboratory, monkeypatch, caplog):
    """Such as one that runs a task's agent, whose first plan takes long before time begins to pass."""
    monkeypatch.setattr(watchdog, "WARNING_S", 0.5)
    text = "async def plans(cell):\n    while not records and now() < late:\n        pass\n"
    names = {"records": caplog.records, "now": time.monotonic, "late": time.monotonic() + 30}
    exec(compile(text, f"{watchdog.PACKAGE}/tasks/slow.py", "exec"), names)
    with caplog.at_level(logging.WARNING, "trocar"):
        assert laboratory.run(names["plans"], 1.0)
    assert f"{watchdog.PACKAGE}/tasks/slow.py, line" in caplog.records[0].getMessage()


def frame(file, line, back=None, name="work"):
    return SimpleNamespace(f_code=SimpleNamespace(co_filename=file, co_name=name), f_lineno=line, f_back=back)


def test_the_line_named_is_the_users_own_or_else_the_innermost_of_a_task():
    task = f"{watchdog.PACKAGE}/tasks/knots.py"
    outer = frame(task, 7, frame(f"{watchdog.PACKAGE}/sim/laboratory.py", 9))
    inner = frame(f"{watchdog.LIBRARIES[0]}/trio.py", 1, frame(task, 5, outer))
    assert watchdog.line_of_script(inner) == f"{task}, line 5"
    outer.f_back.f_back = frame("/home/me/mine.py", 3)
    assert watchdog.line_of_script(inner) == "/home/me/mine.py, line 3"
    outer.f_back.f_back = frame(watchdog.RUNNER, 8, frame("/usr/local/bin/trocar", 3), "run")
    assert watchdog.line_of_script(inner) == f"{task}, line 5"
    assert watchdog.line_of_script(frame(f"{watchdog.LIBRARIES[0]}/trio.py", 1)) == watchdog.line_of_script(None) == ""


def test_another_handler_of_ctrl_c_is_left_alone(laboratory):
    def mine(*_):
        raise AssertionError

    async def looks(cell):
        del cell
        assert signal.getsignal(signal.SIGINT) is mine

    before = signal.signal(signal.SIGINT, mine)
    try:
        assert laboratory.run(looks, 1.0)
    finally:
        signal.signal(signal.SIGINT, before)
