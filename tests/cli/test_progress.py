"""Progress of long work: bars on a terminal, lines elsewhere, nothing with --quiet."""

import io

import pytest
from rich.console import Console

from trocar.cli import progress
from trocar.cli.terminal import be_quiet


class Clock:
    now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def stderr(monkeypatch):
    """Put a file in place of stderr; return what was written to it."""
    written = io.StringIO()
    monkeypatch.setattr(progress, "beside", lambda: Console(file=written, width=80))
    return written


def test_a_line_says_how_far_how_long_and_how_much_longer():
    clock = Clock()
    lines = progress.Lines(clock)
    assert lines.line() == ""
    lines.tick("trials", 4, 20)
    clock.now_s = 30.0
    assert lines.line() == "trials: 4 of 20, 0:30 so far"
    lines.tick("trials", 8, 20, "session 2")
    clock.now_s = 60.0
    assert lines.line() == "trials: 8 of 20, session 2, 1:00 so far, about 3:00 left"


def test_another_piece_of_work_has_a_time_of_its_own():
    clock = Clock()
    lines = progress.Lines(clock)
    lines.tick("sessions", 0, 2)
    clock.now_s = 4000.0
    assert lines.line() == "sessions: 0 of 2, 1:06:40 so far"
    lines.tick("boxes", 0, None, "gap .1")
    clock.now_s += 5.0
    assert lines.line() == "boxes, gap .1, 0:05 so far"


def test_where_there_is_no_terminal_lines_are_written_while_work_lasts(stderr, monkeypatch):
    monkeypatch.setattr(progress, "FIRST_S", 0.01)
    with progress.progress() as tick:
        tick("trials", 1, 2)
        while not stderr.getvalue():
            pass
    said = stderr.getvalue()
    assert said.splitlines()[0] == "trials: 1 of 2, 0:00 so far"
    assert stderr.getvalue() == said, "nobody writes any more"


def test_work_that_is_soon_done_writes_nothing(stderr):
    with progress.progress() as tick, progress.waiting("fitting"):
        tick("trials", 1, 2)
    assert stderr.getvalue() == ""


@pytest.mark.parametrize("shown", [progress.progress, lambda: progress.waiting("fitting")])
def test_quiet_is_quiet(monkeypatch, capsys, shown):
    monkeypatch.setattr(progress, "FIRST_S", 0.0)
    be_quiet(True)
    try:
        with shown() as tick:
            if shown is progress.progress:
                tick("trials", 1, 2)
    finally:
        be_quiet(False)
    assert capsys.readouterr() == ("", "")


def test_a_terminal_has_bars_with_the_time_left(monkeypatch):
    written = io.StringIO()
    monkeypatch.setattr(progress, "beside", lambda: Console(file=written, width=80, force_terminal=True))
    with progress.progress() as tick:
        tick("trials", 1, 2, "session 1")
    assert "session 1" in written.getvalue() and "1/2" in written.getvalue() and "left" in written.getvalue()
