"""Cost of `trocar run --watch`, the rates at which its page is updated, and memory over a long session.

Three parts, one after another:

cost: the same short trial unwatched, and watched with no browser, one, and two (headless Chromiums, which draw without
a graphics card on the same cores: see --fineness), in turn, as fast as they can. Printed: wall time and processor time
of the run's process, divided by those of the unwatched trial before it.

pace: a trial at the pace of the wall clock, with one browser and with two. Printed, per second: moments shown, batches
of poses that a browser got, frames that it drew, and camera images; and the processor time that the page's process
needs for a moment, here and on the machine for which computing times are declared.

memory: trials at the cell's full speed with one browser for ``--minutes``. Printed: growth of the resident memory of
the run's process and of the page's, by a straight line through the readings after the first quarter; and that of the
memory that the run's process has allocated and not freed, of which the C library keeps more than is in use (glibc).

Run: .venv/bin/python benchmarks/bench_watch.py [--parts cost pace memory] [--fineness 0.15]
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import os
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from trocar.console import Watch
from trocar.eval.config import RunConfig
from trocar.eval.prepare import Prepared, prepare
from trocar.eval.run import run_trial
from trocar.log import machine_speed
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.view.console_view import ConsoleMoment

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "view"))
from browser import Page, browser

SIZE = (1400, 900)
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 2**20
LOOK_S = 5.0
"""Time between two readings of the memory."""
COUNT = """
(() => {
  const seen = window.seen = {frames: 0, poses: 0, images: 0, at: performance.now()};
  const queue = window.__viserMutable.messageQueue, push = queue.push;
  queue.push = function(...found) {
    for (const one of found) {
      if (one.type === 'SetPositionMessage' || one.type === 'SceneNodeUpdateMessage') seen.fresh = true;
      if (one.type === 'GuiUpdateMessage' && '_data' in one.updates) seen.images += 1;
    }
    return push.apply(this, found);
  };
  const draw = () => {
    seen.frames += 1;
    if (seen.fresh) { seen.fresh = false; seen.poses += 1; }
    requestAnimationFrame(draw);
  };
  draw();
})()
"""
"""Counts in the browser: frames, frames with new poses, images."""


class Counted(Watch):
    """A page whose moments are counted, and which browsers draw so many times finer than its pixels."""

    def __init__(self, speed: float, fineness: float):
        super().__init__(speed=speed, port=0)
        self.moments, self.images, self.fineness = 0, 0, fineness

    def _moment(self) -> ConsoleMoment:
        moment = super()._moment()
        self.moments += 1
        self.images += len(moment.images)
        return moment

    @property
    def process(self) -> int:
        """Return the process id of the page."""
        assert self._page is not None
        return self._page._process.pid or 0


class Cell:
    """One trial, to be run again and again."""

    def __init__(self, transfers: int):
        self.config = RunConfig(PegTransfer(transfers=transfers), method="uncalibrated", seed=3)
        with TemporaryDirectory() as folder:
            self.prepared: Prepared = prepare(self.config, 0, Path(folder))

    def run(self, watch: Watch | None = None) -> tuple[float, float, float]:
        """Return wall time, processor time of this process, and the cell's time, in s."""
        gc.collect()
        wall, own = time.perf_counter(), time.process_time()
        trial = run_trial(self.config, self.prepared, 0, attendant=watch, raise_errors=True)
        return time.perf_counter() - wall, time.process_time() - own, trial.duration_s


def look_at(page: Page, watch: Counted) -> None:
    """Open the page and wait until it shows the cell."""
    page.open(watch.address, watch.fineness)
    page.until("document.body.innerText.includes('Stop (S)') && !!window.__viserMutable?.drainMessageQueue")


def cost(cell: Cell, rounds: int, pages: list[Page], fineness: float) -> None:
    """Print the ratios of the times of watched trials to those of unwatched ones."""
    ratios: dict[int, list[tuple[float, float]]] = {count: [] for count in range(len(pages) + 1)}
    with Counted(0.0, fineness) as watch:
        cell.run(watch)  # opens the page, and warms up
        for _ in range(rounds):
            for count, found in ratios.items():
                wall, own, _ = cell.run()
                for page in pages[:count]:
                    look_at(page, watch)
                watch.moments = 0
                watched, watched_own, lasted_s = cell.run(watch)
                for page in pages[:count]:
                    page.call("Page.navigate", url="about:blank")
                found.append((watched / wall, watched_own / own))
                print(
                    f"  {count} browsers: {wall:.2f} s alone, {watched:.2f} s watched, for {lasted_s:.1f} s of the"
                    f" cell; on a core {own:.2f} s, {watched_own:.2f} s; {watch.moments} moments",
                    flush=True,
                )
    for count, found in ratios.items():
        wall, own = np.median(found, axis=0)
        print(f"watched by {count} browsers: wall time x {wall:.3f}, its own time on a core x {own:.3f}", flush=True)


def pace(cell: Cell, pages: list[Page], fineness: float) -> None:
    """Print what a page gets per second, at the pace of the wall clock."""
    with Counted(1.0, fineness) as watch:
        watch.console.speed = 0.0
        cell.run(watch)
        for count in range(1, len(pages) + 1):
            for page in pages[:count]:
                look_at(page, watch)
                page.evaluate(COUNT)
            watch.moments = watch.images = 0
            watch.console.speed = 1.0
            before_s = processor_s(watch.process)
            wall, own, lasted_s = cell.run(watch)
            each_ms = 1e3 * (processor_s(watch.process) - before_s) / watch.moments
            print(
                f"{count} browsers, {lasted_s:.1f} s of the cell in {wall:.1f} s ({own / wall:.0%} of a core): "
                f"{watch.moments / wall:.1f} moments and {watch.images / wall:.1f} images a second\n  for a moment the "
                f"page's process needs {each_ms:.0f} ms, on the reference's core {each_ms * machine_speed():.0f} ms"
            )
            for page in pages[:count]:
                seen: Any = page.evaluate("({...window.seen, for: (performance.now() - window.seen.at) / 1e3})")
                page.call("Page.navigate", url="about:blank")
                rates = ", ".join(f"{seen[name] / seen['for']:.1f} {name}" for name in ("frames", "poses", "images"))
                print(f"  a browser got, a second: {rates}", flush=True)


def memory(cell: Cell, minutes: float, pages: list[Page], fineness: float) -> None:
    """Print how memory grows."""
    rows: list[tuple[float, float, float, float, float]] = []
    began, cell_s, trials = time.monotonic(), 0.0, 0
    with Counted(0.0, fineness) as watch:
        cell.run(watch)
        for page in pages[:1]:
            look_at(page, watch)
        while time.monotonic() - began < 60 * minutes:
            cell_s += cell.run(watch)[2]
            trials += 1
            if not rows or time.monotonic() - began - rows[-1][0] > LOOK_S:
                gc.collect()
                used = rss_mb(os.getpid()), rss_mb(watch.process), allocated_mb()
                rows.append((time.monotonic() - began, cell_s, *used))
    found = np.array(rows[len(rows) // 4 :])
    for name, column in (("run's process", 2), ("page's process", 3), ("run's process, in use", 4)):
        slopes = [60 * np.polyfit(found[:, k], found[:, column], 1)[0] for k in (0, 1)]
        print(
            f"the {name}: {rows[0][column]:.0f} MB after the first trial, {rows[-1][column]:.0f} MB after "
            f"{trials} ({cell_s / 60:.0f} min of the cell in {rows[-1][0] / 60:.0f} min); "
            f"{60 * slopes[0]:+.1f} MB an hour of the wall clock, {60 * slopes[1]:+.1f} MB an hour of the cell's",
            flush=True,
        )


def processor_s(process: int) -> float:
    """Return the processor time that a process has used, s."""
    after_name = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return sum(int(ticks) for ticks in after_name[11:13]) / os.sysconf("SC_CLK_TCK")


def rss_mb(process: int) -> float:
    """Return the resident memory of a process, MB."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * PAGE_MB


class MallocInfo(ctypes.Structure):
    """``struct mallinfo2`` of glibc."""

    names = ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")
    _fields_ = [(name, ctypes.c_size_t) for name in names]


def allocated_mb() -> float:
    """Return the memory that this process has allocated and not freed, MB; nan without glibc."""
    info = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if info is None:
        return float("nan")
    info.restype = MallocInfo
    found = info()
    return (found.uordblks + found.hblkhd) / 2**20


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="+", default=["cost", "pace", "memory"])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--minutes", type=float, default=20.0)
    fineness = "Pixels drawn per pixel of the page, on each axis; .15 draws 2 %% of them, in place of a graphics card."
    parser.add_argument("--fineness", type=float, default=1.0, help=fineness)
    given = parser.parse_args()
    cell = Cell(1)
    cell.run()
    with ExitStack() as stack:
        pages = [stack.enter_context(browser(*SIZE)) for _ in range(2)]
        if "cost" in given.parts:
            cost(cell, given.rounds, pages, given.fineness)
        if "pace" in given.parts:
            pace(cell, pages, given.fineness)
        if "memory" in given.parts:
            memory(cell, given.minutes, pages, given.fineness)


if __name__ == "__main__":
    main()
