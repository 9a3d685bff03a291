"""Progress of long work: bars on a terminal, lines elsewhere, nothing with --quiet."""

import io

import pytest
from rich.console import Console
from rich.progress import Progress

from trocar.cli import progress
from trocar.cli.terminal import be_quiet, beside, details, results, rich_table


@pytest.fixture
def stderr(monkeypatch):
    """Put a file in place of stderr; return what was written to it."""
    written = io.StringIO()
    monkeypatch.setattr(progress, "beside", lambda: Console(file=written, width=80))
    return written


def test_a_line_says_how_far_how_long_and_how_much_longer():
    times = [0.0]
    shown = Progress(get_time=lambda: times[0], disable=True, speed_estimate_period=600.0)
    number = shown.add_task("trials", total=20, completed=4)
    said = []
    for times[0], done, now in (
        (30.0, 4, "trials"),
        (60.0, 6, "session 2"),
        (4000.0, 8, "session 2"),
        (4120.0, 11, "trials"),
    ):
        shown.update(number, completed=done, description=now)
        said.append(progress.line_of("trials", shown.tasks[0]))
    assert said == [
        "trials: 4 of 20, 0:00:30 so far",
        "trials: 6 of 20, session 2, 0:01:00 so far",
        "trials: 8 of 20, session 2, 1:06:40 so far",  # too long ago for an estimate
        "trials: 11 of 20, 1:08:40 so far, about 0:06:00 left",
    ]
    shown.add_task("boxes", total=None)
    assert progress.line_of("boxes", shown.tasks[1]) == "boxes, 0:00:00 so far"


def test_where_there_is_no_terminal_lines_of_the_last_piece_of_work_are_written_while_it_lasts(stderr, monkeypatch):
    monkeypatch.setattr(progress, "FIRST_S", 0.2)
    with progress.progress() as tick:
        tick("sessions", 1, 2)
        tick("trials", 0, 9)
        tick("sessions", 2, 2)
        while not stderr.getvalue():
            pass
    said = stderr.getvalue()
    assert said.splitlines()[0].startswith("sessions: 2 of 2, 0:00:0")
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


def test_brackets_are_printed_as_they_are(capsys):
    said = "policy raised ValueError: [batch, 3] of [/weights]"
    for console in (results(), details(), beside()):
        console.print(said, soft_wrap=True)
    results().print(rich_table("", ("why",), [(said,)], text=1))
    printed = capsys.readouterr()
    assert (printed.out + printed.err).count(said) == 4
