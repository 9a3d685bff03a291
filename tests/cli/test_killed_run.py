"""A run killed at any of its writes: the same command finishes as if nothing had happened, and leaves no drafts."""

import os
import signal
import sys
from pathlib import Path

import pytest

from trocar.cli import main

WORDS = ("trocar", "run", "peg-transfer", "--method", "uncalibrated", "--sessions", "2", "--trials", "1", "--json")
MOMENTS = ("half a draft", "a whole draft", "its name just taken")


def run_in_a_process(folder, write=None, moment=""):
    """Run the command in a forked process that kills itself at a write; return its exit code, -9 if it was killed."""
    number = os.fork()
    if number:
        return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])
    try:
        real, writes = Path.replace, iter(range(1000))

        def replace(self, target):
            struck = self.name.endswith((".json", ".npz", ".html")) and next(writes) == write
            if struck and moment == MOMENTS[0]:
                os.truncate(self, self.stat().st_size // 2)
            if struck and moment != MOMENTS[2]:
                os.kill(os.getpid(), signal.SIGKILL)
            real(self, target)
            if struck:
                os.kill(os.getpid(), signal.SIGKILL)

        Path.replace = replace  # type: ignore[method-assign]
        with Path(os.devnull).open("w") as nowhere:
            sys.stdout = sys.stderr = nowhere
            sys.argv = [*WORDS, "--out", str(folder)]
            main()
    except SystemExit as end:
        os._exit(end.code if isinstance(end.code, int) else 0)
    finally:
        os._exit(99)


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_a_run_killed_at_any_of_its_writes_ends_as_one_that_is_not(played, tmp_path):
    assert run_in_a_process(tmp_path / "peace") == 0
    peace = contents(tmp_path / "peace")
    assert len(peace) == 7, "run, two trials with their times, summary, page"
    for write in range(len(peace)):
        folder, moment = tmp_path / str(write), MOMENTS[write % len(MOMENTS)]
        assert run_in_a_process(folder, write, moment) == -signal.SIGKILL
        assert run_in_a_process(folder) == 0
        assert contents(folder) == peace, (write, moment)
