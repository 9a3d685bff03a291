"""Run Python in a process forked from one that has loaded what a run needs, which saves over a second each.

Tests of what a process loads, or of how it starts and stops, use ``subprocess`` instead.
"""

from __future__ import annotations

import multiprocessing
import os
import runpy
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from subprocess import CompletedProcess

LOADED = ("trocar.cli.run", "trocar.eval.jobs", "trocar.report.files", "trocar.report.plot", "trocar.sim.offscreen")
LOADED += tuple(f"trocar.tasks.peg_transfer.{part}" for part in ("task", "world", "agents.unilateral"))
LOADED += (
    "trocar.report.plot",
    "trocar.motion.splines",
    "trocar.calibration.models.play",
    "trocar.view.replay",
    "viser",
    "scipy.optimize",
)
LOADED += ("scipy.interpolate", "matplotlib.backends.backend_agg")
"""Modules that are loaded beforehand; each process loads any others itself."""
LIMIT_S = 600


def python(words: Iterable[object], folder: Path) -> CompletedProcess[str]:
    """Run a script, or ``-c`` and code, with its arguments in a folder.

    Returns:
        Exit code, stdout and stderr.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([*LOADED])
    told = [str(word) for word in words]
    with tempfile.TemporaryDirectory() as said:
        process = context.Process(target=_run, args=(told, str(folder), said, dict(os.environ)))
        process.start()
        process.join(LIMIT_S)
        if process.exitcode is None:
            process.kill()
        out, err = (Path(said, name).read_text() for name in ("stdout", "stderr"))
    return CompletedProcess(told, -1 if process.exitcode is None else process.exitcode, out, err)


def _run(words: list[str], folder: str, said: str, environment: dict[str, str]) -> None:
    """Run the script or code; called in the forked process."""
    for name in ("stdout", "stderr"):
        with Path(said, name).open("w") as file:
            os.dup2(file.fileno(), getattr(sys, f"__{name}__").fileno())
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    if words[0] == "-c":
        sys.argv = ["-c", *words[2:]]
        exec(compile(words[1], "<string>", "exec"), {"__name__": "__main__"})
    else:
        sys.argv = words
        runpy.run_path(words[0], run_name="__main__")


UNPICTURED = """
from trocar.cli import main
from trocar.report import files
files._pictures, files._chart = lambda *rest: [], lambda *rest: None
files.can_photograph = lambda: False
files.find_spec = lambda module: None
main()
"""
"""``trocar`` without pictures and replay, which take longer than a short trial, for tests of other things."""
