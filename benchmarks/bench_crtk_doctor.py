"""Each fault that can be planted in a served robot, heard by ``trocar crtk doctor`` over ROS 2: a line for each.

A cell is served anew for each kind of fault, and once without any; its first arm is moved, the second one rests, and
the doctor listens in a process of its own. Where this machine holds the doctor up, so that it does not judge what it
should, it listens again. Printed: which check should find the fault, whether it did, and which others failed, of whom.
It takes some ten minutes.

    PYTHONPATH=src python benchmarks/bench_crtk_doctor.py [KIND ...]
"""

import json
import math
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from trocar.crtk.bus import open_bus, stamped
from trocar.crtk.fault_kinds import KINDS
from trocar.crtk.messages import Image, JointState
from trocar.lab import load_station
from trocar.lab.topics import Topics

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from crtk_partners import ROOT, process

STATION = "peg-transfer"
MOVED, RESTS = "psm1", "psm2"
PARK = load_station(STATION).arms[MOVED].park_q()
SWING = (0.2, 0.1, 0.01, 0.3, 0.2, 0.2)
HEALTHY = "none"
TRIES = 6
TIMES = ("gaps", "clock", "latency", "jitter")
START_S = 240.0


class Mover:
    """Streams set-points to the first arm until it is closed."""

    def __init__(self, topics: Topics):
        bus, arm = open_bus(topics), topics.of_arm(MOVED)
        self.publisher = bus.publisher(f"{arm}/servo_jp", JointState)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        t = 0.0
        while not self._ended.wait(0.01):
            if self.publisher.readers():  # nobody hears the others
                t += 0.01
                q = [at + swing * math.sin(t) for at, swing in zip(PARK, SWING, strict=True)]
                self.publisher.send(JointState(stamped(), [], q))

    def close(self) -> None:
        """Stream no more."""
        self._ended.set()
        self._thread.join()


def examine(kind: str, arm: str, domain: int) -> tuple[list[dict[str, Any]], int, bool]:
    """Return the doctor's checks of a robot with this fault, how often it listened, and whether it judged."""
    words = [sys.executable, "-m", "trocar", "crtk"]
    fault = [] if kind == HEALTHY else ["--fault", f"{arm}:{kind}"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "ROS_DOMAIN_ID": str(domain)}
    serve, mover = [*words, "serve", STATION, "--seed", "3", *fault], Mover(Topics(domain=domain))
    bus = open_bus(Topics(domain=domain))
    starts = [bus.subscriber("/overhead/color/image_raw", Image), bus.subscriber("/PSM2/jaw/measured_js", JointState)]
    with process(serve, environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as served:
        try:
            deadline_s = time.monotonic() + START_S
            while not all([one.take() or one.last for one in starts]) or not mover.publisher.readers():
                assert served.poll() is None and time.monotonic() < deadline_s, "the cell is not served"
                time.sleep(0.05)
            tried, judged = 0, False
            while not judged and tried < TRIES:
                doctor = subprocess.run(
                    [*words, "doctor", STATION, "--json"], env=environment, capture_output=True, text=True, check=False
                )
                checks, tried = json.loads(doctor.stdout)["checks"], tried + 1
                verdicts = {(check["of"], check["name"]): check["verdict"] for check in checks}
                wanted = TIMES if kind == HEALTHY else (KINDS[kind].found_by,)
                judged = all(verdicts[arm, name] != "not applicable" for name in wanted)
        finally:
            mover.close()
    return checks, tried, judged


def main() -> None:
    """Try all kinds, or those that are named."""
    domain = int(os.environ.get("ROS_DOMAIN_ID", "43"))
    kinds, found, false = sys.argv[1:] or [HEALTHY, *KINDS], 0, 0
    for kind in kinds:
        began_s = time.monotonic()
        arm, wanted = RESTS if kind == "busy" else MOVED, KINDS[kind].found_by if kind != HEALTHY else ""
        checks, tried, judged = examine(kind, arm, domain)
        failed = [(check["of"], check["name"]) for check in checks if check["verdict"] == "fail"]
        well = (arm, wanted) in failed if wanted else not failed
        found += well
        elsewhere = [one for one in failed if one[0] != arm and kind != "swapped"]
        false += len(elsewhere)
        others = ", ".join(f"{of} {name}" for of, name in failed if (of, name) != (arm, wanted))
        missed = "NOT FOUND" if judged else "not judged on this busy machine"
        said = f"{arm} {wanted}: {'found' if well else missed}" if wanted else "nothing" if well else "NOT WELL"
        more = f"; also {others}" if others else ""
        spent = f"{time.monotonic() - began_s:.0f} s{f', {tried} times' if tried > 1 else ''}"
        print(f"{kind:12s} {said}{more}  ({spent})", flush=True)
    print(f"{found} of {len(kinds)} as they should be; {false} checks failed of what has no fault")


if __name__ == "__main__":
    main()
