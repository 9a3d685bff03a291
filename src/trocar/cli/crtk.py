"""``trocar crtk``: be a robot that speaks CRTK."""

from __future__ import annotations

import contextlib
from typing import Annotated

from typer import Option

from trocar.cli.group import Result
from trocar.cli.options import Seed, StationName, need
from trocar.cli.terminal import beside
from trocar.errors import InvalidInput, InvalidValue

MAX_DOMAIN = 232
"""The ports of higher ROS domains are out of range."""


def serve(
    station: StationName,
    *,
    seed: Seed = 0,
    namespace: Annotated[
        list[str] | None, Option(metavar="ARM=/NAME", help="Namespace of an arm's topics; default /PSM1 for psm1.")
    ] = None,
    interface: Annotated[str, Option(help="Address of the network interface; the default reaches this machine.")] = (
        "127.0.0.1"
    ),
    peer: Annotated[list[str] | None, Option(metavar="HOST", help="Another machine to speak with.")] = None,
    domain: Annotated[int | None, Option(help="ROS domain; default: ROS_DOMAIN_ID, or 0.")] = None,
    speed: Annotated[float, Option(help="Seconds of the cell a second.")] = 1.0,
    seconds: Annotated[float | None, Option(help="End after this time of the cell; default: with Ctrl-C.")] = None,
) -> Result:
    """Be a robot that speaks CRTK over ROS 2: a simulated cell in real time, its cables' errors included."""
    need("sim")
    if seconds is not None and not seconds > 0:
        raise InvalidValue("--seconds", seconds, "give more than 0")
    if domain is not None and not 0 <= domain <= MAX_DOMAIN:
        raise InvalidValue("--domain", domain, f"give 0 to {MAX_DOMAIN}")
    from trocar.lab import load_station

    loaded, topics = load_station(station), {}
    for word in namespace or []:
        arm, equals, topic = word.partition("=")
        if not (equals and arm and topic.startswith("/")):
            raise InvalidInput(f"--namespace {word!r}", "is not ARM=/NAME", "give one such as psm1=/PSM1")
        loaded.arm(arm)  # raises if there is none of this name
        topics[arm] = topic
    from trocar.crtk.arm import CrtkNamespace
    from trocar.crtk.server import CrtkServer
    from trocar.lab.laboratory import build_cell
    from trocar.sim.pace import RealTime

    pace, laboratory = RealTime(speed), build_cell(loaded, seed=seed)
    where = CrtkNamespace(topics, interface, tuple(peer or ()), domain)
    server = CrtkServer(laboratory, where)
    names = ", ".join(where.of(name) for name in server.arms)
    beside().print(f"serving {names} on {interface}; Ctrl-C ends it")
    with contextlib.suppress(KeyboardInterrupt):
        laboratory.run(server.serve, seconds or float("inf"), pace)
    summary = {
        "station": station,
        "seconds": laboratory.now_s(),
        "received": {name: arm.received for name, arm in server.arms.items()},
        "events": laboratory.log.events,
    }
    told = ", ".join(f"{count} set-points for {name}" for name, count in summary["received"].items())
    return Result(summary, [f"served for {laboratory.now_s():.1f} s: {told}, {len(laboratory.log.events)} events"])
