"""Scripts of the public CRTK clients, unmodified, against a served cell over ROS 2 and ROS 1: some lines for each.

They are not part of this package: put checkouts of collaborative-robotics/crtk_python_client and jhu-dvrk/dvrk_python
into ``.partners``, and make ``.ros2`` (``tools/ros2.sh --clients``) and ``.ros1`` (``tools/ros1.sh``). Printed for each
script: how it ended, how many of its messages the cell received, and how far the arm was off, in rad, m or elements of
a rotation matrix: from the goal at the end of each move; from the path of a stream; and from the stream itself, which
the cell plays back with a delay that should be constant.

    PYTHONPATH=src python benchmarks/bench_crtk_partners.py [ROS [SCRIPT ...]]
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from trocar.crtk.bus import open_bus
from trocar.crtk.convert import transform_of
from trocar.crtk.messages import JointState, OperatingState, Point, Pose, PoseStamped, Quaternion
from trocar.lab.topics import Topics

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from crtk_partners import ROOT, environment_of, process, python_of, ros1_master, said, served

CLIENT, DVRK = ROOT / ".partners/crtk_python_client", ROOT / ".partners/dvrk_python"
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
"""Each script, its arguments, and how many messages it sends on which topic, according to its source."""
REPORTS = {"setpoint_js": JointState, "jaw/setpoint_js": JointState, "setpoint_cp": PoseStamped}
DELAYS_S = np.arange(0.0, 0.08, 0.0005)
SETTLE_S, START_S = 1.0, 0.3
"""Time for the arm to come to rest; and for a stream until the clocks of sender and receiver are compared."""


class Listener:
    """Records what the arm publishes; clients record their own commands: another subscriber would confuse them."""

    def __init__(self, topics: Topics):
        bus = open_bus(topics)
        kinds: dict[str, type] = {**REPORTS}
        self.sources: dict[str, Any] = {what: bus.subscriber(f"/PSM1/{what}", kind) for what, kind in kinds.items()}
        self.sources["operating_state"] = bus.subscriber("/PSM1/operating_state", OperatingState, latched=True)
        self.heard: dict[str, list[tuple[float, Any]]] = {what: [] for what in self.sources}

    def take_until(self, over: Callable[[], bool], limit_s: float) -> None:
        """Record what the arm publishes until ``over`` is true."""
        end_s = time.monotonic() + limit_s
        while not over():
            if time.monotonic() > end_s:
                raise TimeoutError(f"it is not over within {limit_s:g} s")
            self._take()
            time.sleep(0.005)

    def _take(self) -> None:
        for what, source in self.sources.items():
            for message in source.take():
                stamp = message.header.stamp
                self.heard[what].append((stamp.sec + 1e-9 * stamp.nanosec, message))

    def rows(self, what: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the stamps (n,) and the joints (n, joints), or the poses (n, 12), of a topic."""
        times = [stamp_s for stamp_s, _ in self.heard[what]]
        values = [
            message.position if isinstance(message, JointState) else matrix_of(message.pose)
            for _, message in self.heard[what]
        ]
        return np.array(times), np.array(values)

    def add_sent(self, file: Path) -> dict[str, int]:
        """Add the messages that the client published, from its file; return their number by topic."""
        counts: dict[str, int] = {}
        for topic, stamp_s, value in json.loads(file.read_text()) if file.exists() else ():
            what = topic.removeprefix("/PSM1/")
            pose = len(value) == 7
            message = (
                PoseStamped(pose=Pose(Point(*value[:3]), Quaternion(*value[3:])))
                if pose
                else JointState(position=value)
            )
            self.heard.setdefault(what, []).append((stamp_s, message))
            counts[what] = counts.get(what, 0) + 1
        return counts


def matrix_of(pose: Pose) -> np.ndarray:
    """Return the three upper rows of a pose's matrix (12,)."""
    return transform_of(pose).matrix[:3].ravel(order="F")


def stream_deviation(listener: Listener, command: str, report: str) -> dict[str, float]:
    """Return how far the playback of a stream was off its path, and off the stream at the best delay."""
    times, wanted = listener.rows(command)
    told_s, told = listener.rows(report)
    gaps = np.flatnonzero(np.diff(times) > 0.1)  # between two streams, the script does something else
    best = {"median": np.inf}
    for delay_s in DELAYS_S:
        at_s = told_s - delay_s
        inside = (at_s > times[0] + START_S) & (at_s < times[-1])
        for gap in gaps:
            inside &= (at_s < times[gap]) | (at_s > times[gap + 1] + START_S)
        model = np.stack([np.interp(at_s[inside], times, column) for column in wanted.T], axis=1)
        off = np.abs(told[inside] - model).max(axis=1)
        if np.median(off) < best["median"]:
            found = path_deviation(told[inside], wanted)
            best = {"path": float(found.max()), "path_median": float(np.median(found))}
            best |= {"timed": float(off.max()), "median": float(np.median(off)), "delay_s": round(float(delay_s), 4)}
    return best


def path_deviation(told: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the distances (n,) of points (n, joints) from a polyline (m, joints): the largest of all joints."""
    start, along = wanted[:-1], np.diff(wanted, axis=0)
    length = np.maximum((along**2).sum(axis=1), 1e-30)
    found = []
    for point in told:
        share = np.clip(((point - start) * along).sum(axis=1) / length, 0.0, 1.0)
        found.append(float(np.abs(start + share[:, None] * along - point).max(axis=1).min()))
    return np.array(found)


def move_deviation(listener: Listener, command: str, report: str) -> dict[str, float]:
    """Return how far the arm was from the goals of its moves at their ends."""
    times, goals = listener.rows(command)
    told_s, told = listener.rows(report)
    rivals = ("jaw/servo_jp", "jaw/move_jp") if command[:3] == "jaw" else ("servo_jp", "servo_cp", "move_jp", "move_cp")
    later_s = np.sort([stamp_s for what in rivals for stamp_s, _ in listener.heard.get(what, ())])
    idle_s = np.array([stamp_s for stamp_s, message in listener.heard["operating_state"] if not message.is_busy])
    worst = 0.0
    for at_s, goal in zip(times, goals, strict=True):
        end_s = np.append(idle_s[idle_s > at_s], np.inf)[0]
        rival_s = np.append(later_s[later_s > at_s], np.inf)[0]
        after = np.flatnonzero(told_s >= end_s)
        if len(after) and rival_s > told_s[after[0]]:  # nothing else took over
            worst = max(worst, float(np.abs(told[after[0]] - goal).max()))
    return {"goal": worst}


def run_script(topics: Topics, script: Path, words: list[str], sends: dict[str, int]) -> dict[str, Any]:
    """Serve a cell, run a script against it, and return the results."""
    listener, ros = Listener(topics), topics.ros
    serve = ["--ros", str(ros), "--domain", str(topics.domain or 0), "--master", topics.master]
    environment = environment_of(ros, topics.domain or 0, topics.master)
    sent = Path(tempfile.mkdtemp()) / "sent.json"
    paths = (Path(__file__).parent / "crtk_recording", CLIENT / "src", DVRK / "src")
    environment |= {"PYTHONPATH": os.pathsep.join(map(str, paths)), "CRTK_SENT": str(sent)}
    with tempfile.TemporaryFile("w+") as told, served(*serve) as cell:
        listener.take_until(lambda: bool(listener.heard["operating_state"]), 60.0)
        start_s = time.monotonic()
        command = [str(python_of(ros)), str(script), *words]
        with process(command, environment, stdin=subprocess.PIPE, stdout=told, stderr=told) as client:
            assert client.stdin
            client.stdin.write("\n" * 20)  # where it waits for a key
            client.stdin.close()
            listener.take_until(lambda: client.poll() is not None, 120.0)
        took_s, rest_s = time.monotonic() - start_s, time.monotonic() + SETTLE_S
        listener.take_until(lambda: time.monotonic() > rest_s, 2 * SETTLE_S)
        told.seek(0)
        errors = [line for line in told.read().splitlines() if "Error" in line]
        summary = said(cell)
    row: dict[str, Any] = {"ros": ros, "script": script.name, "exit": client.returncode, "s": round(took_s, 1)}
    row["error"] = errors[-1] if client.returncode and errors else ""
    row["refused"] = [event["reason"] for event in summary["events"] if event["name"] == "refused"]
    received = summary["commands"]["psm1"]
    counts = listener.add_sent(sent)
    for what, count in sends.items():
        if counts.get(what, 0) != count:
            row["error"] = f"sent {counts.get(what, 0)} {what}, not {count}"
            continue
        report = "setpoint_cp" if what.endswith("_cp") else "setpoint_js"
        report = f"jaw/{report}" if what.startswith("jaw/") else report
        off = (stream_deviation if "servo" in what else move_deviation)(listener, what, report)
        row[what] = {"sent": count, "received": received.get(what, 0), **off}
    return row


def print_row(row: dict[str, Any]) -> None:
    """Print a line for the script and one for each topic that it sends."""
    told = row["error"] or "; ".join(row["refused"])
    print(f"ROS {row['ros']}  {row['script']:28s} exit {row['exit']:3d}  {row['s']:5.1f} s  {told}", flush=True)
    for what, found in row.items():
        if isinstance(found, dict):
            off = ", ".join(f"{name} {value:.1e}" for name, value in found.items() if name not in ("sent", "received"))
            print(f"       {what:14s} received {found['received']} of {found['sent']}; off by: {off}", flush=True)


def run_all(ros: int, only: list[str]) -> None:
    """Run the scripts over ROS 1 or ROS 2."""
    domain = int(os.environ.get("ROS_DOMAIN_ID", "42"))
    with ros1_master() if ros == 1 else nullcontext("") as master:
        topics = Topics(ros=1, master=master) if ros == 1 else Topics(ros=2, domain=domain)
        for script, words, sends in SCRIPTS:
            if not only or script.name in only:
                print_row(run_script(topics, script, words, sends))


def main() -> None:
    """Run what is installed, each version of ROS in a process; for ROS 1, in the Python that has rospy."""
    if len(sys.argv) > 1:
        run_all(int(sys.argv[1]), sys.argv[2:])
        return
    missing = [place.name for place in (CLIENT, DVRK) if not place.exists()]
    if missing:
        print(f"nothing to run: no {' and no '.join(missing)} in .partners")
        return
    for ros in (2, 1):
        if not python_of(ros).exists():
            print(f"ROS {ros}: there is no .ros{ros}; tools/ros{ros}.sh makes it")
        else:
            subprocess.run([python_of(1) if ros == 1 else sys.executable, __file__, str(ros)], check=True)


if __name__ == "__main__":
    main()
