"""The public CRTK clients' scripts, unmodified, against a served cell over ROS 2 and ROS 1: a row for each.

They are not part of this package: put the checkouts of collaborative-robotics/crtk_python_client and
jhu-dvrk/dvrk_python into ``.partners``, and make ``.ros2`` (``tools/ros2.sh --clients``) and ``.ros1``
(``tools/ros1.sh``). Of each script it says how it ended; how many set-points and moves it sent, as another subscriber
heard them, and how many the cell received; and how far the arm was from what was commanded: at the end of each move,
and all along each stream, which is played back a constant time later.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from trocar.crtk.bus import open_bus
from trocar.crtk.convert import transform_of
from trocar.crtk.messages import JointState, OperatingState, PoseStamped
from trocar.lab.topics import Topics

ROOT = Path(__file__).parents[1]
CLIENT, DVRK = ROOT / ".partners/crtk_python_client", ROOT / ".partners/dvrk_python"
DOMAIN, MASTER = int(os.environ.get("ROS_DOMAIN_ID", "42")), os.environ.get("ROS_MASTER_URI", "http://127.0.0.1:11342")
SCRIPTS = [
    (CLIENT / "scripts/crtk_rate_example.py", [], {}),
    (CLIENT / "scripts/crtk_servo_jp_example.py", ["PSM1"], {"servo_jp": 2000}),
    (CLIENT / "scripts/crtk_servo_cp_example.py", ["PSM1"], {"servo_cp": 2000}),
    (CLIENT / "scripts/crtk_move_cp_example.py", ["PSM1"], {"move_cp": 3}),
    (DVRK / "scripts/dvrk_move_wait_test.py", ["-a", "PSM1"], {"move_jp": 6}),
    (
        DVRK / "scripts/dvrk_arm_test.py",
        ["-a", "PSM1"],
        {"servo_jp": 500, "servo_cp": 500, "move_jp": 8, "move_cp": 6},
    ),
    (
        DVRK / "scripts/dvrk_psm_test.py",
        ["-a", "PSM1"],
        {"move_jp": 11, "move_cp": 6, "jaw/servo_jp": 2000, "jaw/move_jp": 21},
    ),
    (DVRK / "scripts/dvrk_latency_test.py", [], {}),
]
"""Each script, its words, and how often it sends what."""
COMMANDS = {
    **dict.fromkeys(("servo_jp", "move_jp", "jaw/servo_jp", "jaw/move_jp"), JointState),
    **dict.fromkeys(("servo_cp", "move_cp"), PoseStamped),
}
REPORTS = {"setpoint_js": JointState, "jaw/setpoint_js": JointState, "setpoint_cp": PoseStamped}
DELAYS_S = np.arange(0.0, 0.08, 0.0005)
SETTLE_S = 1.0


class Listener:
    """Hears what is commanded and what the arm says, beside the script."""

    def __init__(self, topics: Topics):
        bus = open_bus(topics)
        kinds = COMMANDS | REPORTS
        self.sources: dict[str, Any] = {what: bus.subscriber(f"/PSM1/{what}", kind) for what, kind in kinds.items()}
        self.sources["operating_state"] = bus.subscriber("/PSM1/operating_state", OperatingState, latched=True)
        self.heard: dict[str, list[tuple[float, Any]]] = {what: [] for what in self.sources}

    def take(self) -> None:
        for what, source in self.sources.items():
            for message in source.take():
                stamp = message.header.stamp
                self.heard[what].append((stamp.sec + 1e-9 * stamp.nanosec, message))

    def rows(self, what: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the stamps (n,) and the joints (n, joints), or the poses (n, 3 + 9), of a topic."""
        times = np.array([stamp_s for stamp_s, _ in self.heard[what]])
        values = [
            message.position
            if isinstance(message, JointState)
            else transform_of(message.pose).matrix[:3].ravel(order="F")
            for _, message in self.heard[what]
        ]
        return times, np.array(values)


def stream_deviation(listener: Listener, command: str, report: str) -> dict[str, float]:
    """Return how far a stream was played back from its path, and from it at the best constant delay."""
    times, wanted = listener.rows(command)
    told_s, told = listener.rows(report)
    gaps = np.flatnonzero(np.diff(times) > 0.1)  # between two streams it does something else
    best = {"timed": np.inf}
    for delay_s in DELAYS_S:
        at_s = told_s - delay_s
        inside = (at_s > times[0] + 0.05) & (at_s < times[-1])
        for gap in gaps:
            inside &= (at_s < times[gap]) | (at_s > times[gap + 1] + 0.05)
        model = np.stack([np.interp(at_s[inside], times, column) for column in wanted.T], axis=1)
        off = float(np.abs(told[inside] - model).max())
        if off < best["timed"]:
            best = {"path": path_deviation(told[inside], wanted), "timed": off, "delay_s": round(float(delay_s), 4)}
    return best


def path_deviation(told: np.ndarray, wanted: np.ndarray) -> float:
    """Return the greatest distance of points (n, joints) from a line through others (m, joints)."""
    start, along = wanted[:-1], np.diff(wanted, axis=0)
    length = np.maximum((along**2).sum(axis=1), 1e-30)
    worst = 0.0
    for point in told:
        share = np.clip(((point - start) * along).sum(axis=1) / length, 0.0, 1.0)
        worst = max(worst, float(np.abs(start + share[:, None] * along - point).max(axis=1).min()))
    return worst


def move_deviation(listener: Listener, command: str, report: str) -> float:
    """Return the greatest difference from the goal at the ends of moves."""
    times, goals = listener.rows(command)
    told_s, told = listener.rows(report)
    others_s = np.sort(
        np.concatenate([listener.rows(what)[0] for what in ("servo_jp", "servo_cp", "move_jp", "move_cp")])
    )
    busy = [(stamp_s, message.is_busy) for stamp_s, message in listener.heard["operating_state"]]
    worst = 0.0
    for at_s, goal in zip(times, goals, strict=True):
        ends = [stamp_s for stamp_s, is_busy in busy if stamp_s > at_s and not is_busy]
        later = others_s[others_s > at_s]
        if not ends or (command[:3] != "jaw" and len(later) and later[0] < ends[0]):
            continue  # another motion took over
        after = np.flatnonzero(told_s >= ends[0])
        if len(after):
            worst = max(worst, float(np.abs(told[after[0]] - goal).max()))
    return worst


@contextmanager
def process(words: list[str], environment: dict[str, str], **options: Any) -> Iterator[subprocess.Popen[str]]:
    running = subprocess.Popen(words, env=environment, text=True, **options)
    try:
        yield running
    finally:
        running.kill()
        running.wait()


def run_script(ros: int, script: Path, words: list[str], sends: dict[str, int]) -> dict[str, Any]:
    topics = Topics(ros=ros, domain=DOMAIN, master=MASTER)
    listener = Listener(topics)
    serve = [sys.executable, "-m", "trocar", "crtk", "serve", "peg-transfer", "--seed", "1", "--json"]
    serve += ["--ros", str(ros), "--domain", str(DOMAIN), "--master", MASTER]
    python = ROOT / f".ros{ros}/bin/python"
    folder = tempfile.mkdtemp()
    environment = {**os.environ, "ROS_VERSION": str(ros), "ROS_DOMAIN_ID": str(DOMAIN), "ROS_MASTER_URI": MASTER}
    environment |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_HOSTNAME": "127.0.0.1", "ROS_HOME": folder}
    public = {**environment, "PYTHONPATH": f"{CLIENT / 'src'}:{DVRK / 'src'}"}
    quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with process(serve, environment, **quiet) as server:
        deadline_s = time.monotonic() + 60
        while not listener.heard["operating_state"]:
            if time.monotonic() > deadline_s or server.poll() is not None:
                sys.exit(f"the cell does not start: {server.communicate()[1]}")
            listener.take()
            time.sleep(0.01)
        start_s = time.monotonic()
        with (
            tempfile.TemporaryFile("w+") as said,
            process(
                [str(python), str(script), *words], public, stdin=subprocess.PIPE, stdout=said, stderr=said
            ) as client,
        ):
            assert client.stdin
            client.stdin.write("\n" * 20)
            client.stdin.close()
            while client.poll() is None:
                listener.take()
                time.sleep(0.005)
            said.seek(0)
            told = said.read().splitlines()
            status = client.returncode
        took_s, end_s = time.monotonic() - start_s, time.monotonic() + SETTLE_S
        while time.monotonic() < end_s:
            listener.take()
            time.sleep(0.005)
        server.send_signal(2)
        summary = json.loads(server.communicate(timeout=60)[0])
    received = summary["commands"]["psm1"]
    row: dict[str, Any] = {"ros": ros, "script": script.name, "exit": status, "s": round(took_s, 1)}
    if status:
        row["why"] = [line for line in told if "Error" in line or "  ! " in line][-2:]
    for what in COMMANDS:
        if count := len(listener.heard[what]):
            report = {"p": "setpoint_js", "c": "setpoint_cp"}["c" if what.endswith("_cp") else "p"]
            report = f"jaw/{report}" if what.startswith("jaw/") else report
            off = (stream_deviation if "servo" in what else move_deviation)(listener, what, report)
            row[what] = {"sends": sends.get(what, 0), "heard": count, "received": received.get(what, 0), "off": off}
    row["refused"] = [event for event in summary["events"] if event["name"] == "refused"]
    row["limit_use"] = max(summary["limit_use"]["psm1"])
    return row


def main() -> None:
    if len(sys.argv) > 1:
        only = sys.argv[2:]
        for script, words, sends in SCRIPTS:
            if not only or script.name in only:
                print(json.dumps(run_script(int(sys.argv[1]), script, words, sends)), flush=True)
        return
    missing = [place.name for place in (CLIENT, DVRK) if not place.exists()]
    if missing:
        print(f"nothing to run: no {' and no '.join(missing)} in .partners")
        return
    for ros in (2, 1):
        python = ROOT / ".ros1/bin/python" if ros == 1 else sys.executable
        if not (ROOT / f".ros{ros}/bin/python").exists():
            print(f"ROS {ros}: there is no .ros{ros}; tools/ros{ros}.sh makes it")
            continue
        master = [
            str(python),
            "-c",
            "import rosmaster; rosmaster.rosmaster_main()",
            "--core",
            "-p",
            MASTER.split(":")[-1],
        ]
        idle = [sys.executable, "-c", "import time; time.sleep(1e9)"]
        with process(master if ros == 1 else idle, dict(os.environ), stdout=subprocess.DEVNULL):
            subprocess.run([python, __file__, str(ros)], check=True)


if __name__ == "__main__":
    main()
