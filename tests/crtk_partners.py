"""Test partners of trocar.crtk: a served cell in a process of its own, and programs on the real rclpy and rospy."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
DOMAIN = 40 + os.getpid() % 150
"""A ROS domain for the tests of this process alone."""
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "ROS_DOMAIN_ID": str(DOMAIN)}
"""Environment of programs that run in this Python."""
ANYBODYS = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(ROOT / "tests")])}
"""Environment of programs that may run in the Python of ROS 1."""
LIMIT_S = 30.0


def until(holds: Callable[[], object]) -> None:
    """Wait until a condition holds; fail after ``LIMIT_S``."""
    end_s = time.monotonic() + LIMIT_S
    while not holds():
        assert time.monotonic() < end_s, "it does not come to that"
        time.sleep(0.01)


def trocar(*words: object, stderr: int = subprocess.STDOUT) -> subprocess.Popen[str]:
    """Start a command of trocar."""
    command = [sys.executable, "-m", "trocar", *map(str, words)]
    return subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=stderr, text=True)


def python_of(ros: int) -> Path:
    """Return the Python that ``tools/ros1.sh`` or ``tools/ros2.sh`` makes."""
    return ROOT / f".ros{ros}" / "bin" / "python"


@contextmanager
def process(words: list[str], environment: dict[str, str], **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Start a process, and kill it at the end of the block."""
    running = subprocess.Popen(words, env=environment, text=True, **options)
    try:
        yield running
    finally:
        running.kill()
        running.wait()


@contextmanager
def ros1_master() -> Iterator[str]:
    """Start a ROS 1 master on the loopback interface; yield its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"http://127.0.0.1:{port}"
    words = [str(python_of(1)), "-c", "import rosmaster; rosmaster.rosmaster_main()", "--core", "-p", str(port)]
    with tempfile.TemporaryDirectory() as home:
        environment = {**os.environ, "ROS_MASTER_URI": address, "ROS_HOSTNAME": "127.0.0.1", "ROS_HOME": home}
        with process(words, environment, stdout=subprocess.DEVNULL) as master:
            end_s = time.monotonic() + 30
            while not _answers(address):
                assert master.poll() is None and time.monotonic() < end_s, "the master does not start"
                time.sleep(0.02)
            yield address


def _answers(address: str) -> bool:
    try:
        urllib.request.urlopen(address, timeout=1.0)
    except urllib.error.HTTPError:
        return True  # it speaks, but not to a browser
    except OSError:
        return False
    return True


def environment_of(ros: int, domain: int = 0, master: str = "") -> dict[str, str]:
    """Return the environment of a program of ROS 1 or 2 that stays on the loopback interface."""
    return {
        "PATH": os.environ["PATH"],
        "HOME": os.environ.get("HOME", tempfile.gettempdir()),
        "ROS_VERSION": str(ros),
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_MASTER_URI": master,
        "ROS_HOSTNAME": "127.0.0.1",
    }


@contextmanager
def served(*words: str, python: Path = Path(sys.executable)) -> Iterator[subprocess.Popen[str]]:
    """Serve a cell in a process; ``said`` interrupts it and returns its summary."""
    command = [str(python), "-m", "trocar", "crtk", "serve", "peg-transfer", "--seed", "3", "--json", *words]
    with process(command, ANYBODYS, stdout=subprocess.PIPE) as running:
        yield running


def said(running: subprocess.Popen[str]) -> dict[str, Any]:
    """Interrupt a served cell and return the summary that it prints."""
    running.send_signal(2)
    return json.loads(running.communicate(timeout=60)[0])


@contextmanager
def controlled(
    dialect: str, start: Iterable[float], *, ros: int = 2, domain: int = DOMAIN, master: str = "-"
) -> Iterator[subprocess.Popen[str]]:
    """Yield the process of a controller whose joints start at ``start``; see ``crtk/controllers.py``."""
    python = python_of(1) if ros == 1 else sys.executable
    words = [python, ROOT / "tests/crtk/controllers.py", dialect, ros, domain, master, json.dumps([*start])]
    with process([*map(str, words)], ANYBODYS, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as running:
        assert running.stdout is not None and running.stdout.readline() == "ready\n"
        yield running


PATIENT = {"stale_s": 5.0, "max_stall_s": 60.0, "max_late": 10000, "lag_s": 5.0, "watchdog_s": 60.0}
PATIENT |= {"following_rad": 0.2, "following_m": 0.02}


def patient(station):
    """Make the loop in a client's station file tolerate a busy machine, for tests of other things.

    When the process that serves an arm is held up, the arm passes its goal for a moment.
    """
    loop = ", ".join(f"{name} = {value}" for name, value in PATIENT.items())
    text = station.read_text("utf-8")
    assert "[crtk]\n" in text
    station.write_text(text.replace("[crtk]\n", f"[crtk]\nloop = {{ {loop} }}\n"), encoding="utf-8")
