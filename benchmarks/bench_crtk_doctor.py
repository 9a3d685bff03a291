"""Does ``trocar crtk doctor`` find each fault that can be planted in a served robot, over ROS 2? A line for each fault.

The robot, the client that moves its first arm and the doctor are processes of their own. One robot has one fault after
the other; each fault that exists from the start gets a robot of its own. If the machine is so busy that the doctor does
not judge a check, it listens again. Printed: which check should find the fault, whether it did, and which other checks
failed. It takes three minutes.

    PYTHONPATH=src python benchmarks/bench_crtk_doctor.py [KIND ...]
"""

import math
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from typing import Any

from trocar.cli.crtk import doctor
from trocar.crtk import faults
from trocar.crtk.bus import open_bus, stamped
from trocar.crtk.fault_kinds import KINDS, Kind
from trocar.crtk.messages import Image, JointState
from trocar.crtk.served_cell import ServedCell
from trocar.lab import load_station
from trocar.lab.laboratory import build_cell
from trocar.lab.topics import Topics

STATION, MOVED, RESTS = "peg-transfer", "psm1", "psm2"
SWING = (0.2, 0.1, 0.01, 0.3, 0.2, 0.2)
HEALTHY = "none"
TIMES = ("gaps", "clock", "latency", "jitter")
TRIES, START_S = 6, 240.0
TOPICS = Topics(domain=int(os.environ.get("ROS_DOMAIN_ID", "43")))
FORK = get_context("fork")  # saves loading everything again in each of many processes
NOW = FORK.Value("i", -1)
"""The fault that the robot has now: an index into ``KINDS``; -1: none."""


def arm_of(kind: str) -> str:
    """Return the arm that gets a fault: to be busy is a fault only of an arm that rests."""
    return RESTS if kind == "busy" else MOVED


def gated(kind: Kind, index: int) -> Kind:
    """Return a fault that acts only while ``NOW`` is its index."""

    def change(place: Any) -> Any:
        assert kind.change is not None
        inner = kind.change(place)
        return lambda message: inner(message) if NOW.value == index else message

    def delay_s(value: Any, rng: Any) -> float:
        assert kind.delay_s is not None
        return kind.delay_s(value, rng) if NOW.value == index else 0.0

    return replace(kind, change=kind.change and change, delay_s=kind.delay_s and delay_s)


def serve(kinds: Sequence[str]) -> None:
    """Serve a cell that can have these faults, until SIGTERM."""
    faults.KINDS = {
        name: kind if kind.from_the_start else gated(kind, k) for k, (name, kind) in enumerate(KINDS.items())
    }
    planted = [faults.Fault(arm_of(name), name, KINDS[name].value) for name in kinds]
    with ServedCell(build_cell(load_station(STATION), seed=3), TOPICS, faults=planted) as served:
        served.run(math.inf)


def move() -> None:
    """Stream set-points to the first arm without end."""
    out = open_bus(TOPICS).publisher(f"{TOPICS.of_arm(MOVED)}/servo_jp", JointState)
    park, t = load_station(STATION).arms[MOVED].park_q(), 0.0
    while True:
        t += 0.01 if out.readers() else 0.0
        q = [at + swing * math.sin(t) for at, swing in zip(park, SWING, strict=True)]
        out.send(JointState(stamped(), [], q))
        time.sleep(0.01)


def await_start() -> None:
    """Wait until the topics that the robot publishes last have come."""
    bus, deadline_s = open_bus(TOPICS), time.monotonic() + START_S
    starts = [bus.subscriber("/overhead/color/image_raw", Image), bus.subscriber("/PSM2/jaw/measured_js", JointState)]
    while not all([one.take() or one.last for one in starts]):
        assert time.monotonic() < deadline_s, "the cell is not served"
        time.sleep(0.05)


def examine() -> dict[tuple[str, str], str]:
    """Return the doctor's verdicts, by subject and check."""
    checks = doctor(STATION, domain=TOPICS.domain).summary["checks"]
    return {(check["of"], check["name"]): check["verdict"] for check in checks}


@contextmanager
def running(target: Any, *args: Any) -> Iterator[None]:
    """Run a function in a process during the block."""
    process = FORK.Process(target=target, args=args)
    process.start()
    try:
        yield
    finally:
        process.terminate()
        process.join(20.0)
        process.kill()


def try_kind(kind: str) -> tuple[bool, int]:
    """Print the doctor's verdict on a robot with this fault; return whether it is right, and others' failures."""
    arm, began_s, tried, judged = arm_of(kind), time.monotonic(), 0, False
    wanted = KINDS[kind].found_by if kind != HEALTHY else ""
    verdicts: dict[tuple[str, str], str] = {}
    while not judged and tried < TRIES:
        with FORK.Pool(1) as pool:
            verdicts, tried = pool.apply(examine), tried + 1
        judged = all(verdicts[arm, name] != "not applicable" for name in ([wanted] if wanted else TIMES))
    failed = [one for one, verdict in verdicts.items() if verdict == "fail"]
    well = (arm, wanted) in failed if wanted else not failed
    missed = "NOT FOUND" if judged else "not judged on this busy machine"
    said = f"{arm} {wanted}: {'found' if well else missed}" if wanted else "nothing" if well else "NOT WELL"
    others = ", ".join(f"{of} {name}" for of, name in failed if (of, name) != (arm, wanted))
    spent = f"{time.monotonic() - began_s:.0f} s{f', {tried} times' if tried > 1 else ''}"
    print(f"{kind:12s} {said}{f'; also {others}' if others else ''}  ({spent})", flush=True)
    return well, sum(of != arm for of, _ in failed if kind != "swapped")


def main() -> None:
    """Try all kinds, or those that are named."""
    kinds = sys.argv[1:] or [HEALTHY, *KINDS]
    lasting = [kind for kind in kinds if kind != HEALTHY and KINDS[kind].from_the_start]
    others = [kind for kind in kinds if kind not in lasting]
    found = []
    with running(move):
        for group in (others, *([kind] for kind in lasting)):
            with running(serve, [kind for kind in group if kind != HEALTHY]):
                with FORK.Pool(1) as pool:
                    pool.apply(await_start)
                for kind in group:
                    NOW.value = -1 if kind == HEALTHY else list(KINDS).index(kind)
                    found.append(try_kind(kind))
    well, wrong = sum(well for well, _ in found), sum(count for _, count in found)
    print(f"{well} of {len(kinds)} as they should be; {wrong} checks failed of what has no fault")


if __name__ == "__main__":
    main()
