"""Set-points over the network at 100, 200 and 500 Hz, from the hardware loop to a served cell: losses, delays, limits.

A listener in a process of its own notes each set-point and when it came. Times depend on the machine.

    python benchmarks/bench_crtk.py                  # 20 s a rate, over ROS 2
    python benchmarks/bench_crtk.py --seconds 600 --rates 200 500
    python benchmarks/bench_crtk.py --ros 1          # where rospy and a master are (tools/ros1.sh)
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import time
from functools import partial
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np
from bench_hardware_loop import ARMS, LIMITS, STATION, swing

from trocar.crtk.arm import CrtkArm
from trocar.crtk.bus import open_bus
from trocar.crtk.messages import JointState
from trocar.hardware import HardwareLaboratory, LoopSettings
from trocar.lab.topics import Topics

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from crtk_partners import said, served

POLL_S = 0.0003


class CountingArm(CrtkArm):
    """An arm over the network that counts the set-points that it sends, into a file."""

    def __init__(self, name: str, topics: Topics, folder: Path):
        super().__init__(name, topics)
        self._count, self._file = 0, folder / f"{name}.count"

    def send(self, q, velocity, jaw_rad):
        """Send a set-point."""
        super().send(q, velocity, jaw_rad)
        self._count += 1

    def close(self):
        """Write the count."""
        super().close()
        self._file.write_text(str(self._count))


def listen(topics: Topics, ready: Event, over: Event, path: Path) -> None:
    """Record stamp, arrival and joints of every set-point of the first arm, until ``over`` is set."""
    heard = open_bus(topics).subscriber(f"{topics.of_arm(ARMS[0])}/servo_jp", JointState)
    rows = []
    ready.set()
    while not over.is_set():
        for message in heard.take():
            stamp = message.header.stamp
            rows.append([stamp.sec + 1e-9 * stamp.nanosec, time.time(), *message.position])
        time.sleep(POLL_S)
    np.save(path, np.array(rows).reshape(-1, 8))


def steady(topics: Topics, rate_hz: int, seconds: float) -> None:
    """Stream set-points for some time; print losses, delays and the use of the limits."""
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as name:
        folder, tick_s = Path(name), 1.0 / rate_hz
        ready, over = context.Event(), context.Event()
        listener = context.Process(target=listen, args=(topics, ready, over, folder / "heard.npy"))
        listener.start()
        ready.wait(30.0)
        words = ("--ros", str(topics.ros), "--domain", str(topics.domain), "--master", topics.master)
        settings = LoopSettings(tick_s=tick_s, max_late=10**9, max_stall_s=10.0, stale_s=2.0, lag_s=2.0)
        connect = partial(CountingArm, topics=topics, folder=folder)
        with served(*words) as cell:
            reads = open_bus(topics).subscriber(f"{topics.of_arm(ARMS[0])}/measured_js", JointState)
            while not reads.take():  # a busy machine takes its time
                assert cell.poll() is None, "it has ended"
                time.sleep(0.1)
            with HardwareLaboratory(STATION, connect, settings) as laboratory:
                laboratory.run(lambda cell: swing(cell, seconds), seconds + 30.0)
            time.sleep(0.5)
            told = said(cell)
        over.set()
        listener.join()
        sent = int((folder / f"{ARMS[0]}.count").read_text())
        rows = np.load(folder / "heard.npy")
    latency_s, gaps_s = rows[:, 1] - rows[:, 0], np.diff(rows[:, 0])
    step = float(np.abs(np.diff(rows[:, 2:], axis=0) / (LIMITS.velocity * tick_s)).max())
    print(
        f"ROS {topics.ros}, {rate_hz} Hz, {seconds:g} s: {sent} set-points sent, {len(rows)} heard, "
        f"{told['received'][ARMS[0]]} received; latency {1e3 * np.median(latency_s):.2f} ms (p50), "
        f"{1e3 * np.percentile(latency_s, 99.9):.2f} (p99.9), {1e3 * latency_s.max():.1f} (max); gaps "
        f"{1e3 * np.median(gaps_s):.2f} ms (p50), {1e3 * np.percentile(gaps_s, 99.9):.2f} (p99.9), "
        f"{1e3 * gaps_s.max():.1f} (max); largest step {step:.3f} of the limit; driven at most at "
        f"{max(told['limit_use'][ARMS[0]]):.4f} of the limits"
    )


def main() -> None:
    """Measure each rate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rates", type=int, nargs="*", default=[100, 200, 500], metavar="HZ")
    parser.add_argument("--ros", type=int, default=2)
    parser.add_argument("--domain", type=int, default=207)  # the tests take 40 to 190
    parser.add_argument("--master", default="http://127.0.0.1:11311")
    given = parser.parse_args()
    topics = Topics(ros=given.ros, domain=given.domain, master=given.master)
    for rate_hz in given.rates:
        steady(topics, rate_hz, given.seconds)


if __name__ == "__main__":
    main()
