"""``trocar crtk``: be a robot that speaks CRTK."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Annotated

from typer import Option

from trocar.cli.group import Result
from trocar.cli.options import Seed, StationName, need
from trocar.cli.terminal import beside
from trocar.errors import InvalidValue
from trocar.lab.topics import MAX_DOMAIN, Topics

Ros = Annotated[int | None, Option(help="1 or 2.", show_default="the station's, or 2")]
Interface = Annotated[
    str | None, Option(help="Address of the network interface.", show_default="the station's, or 127.0.0.1")
]
Peer = Annotated[list[str] | None, Option(metavar="HOST", help="Another machine to speak with (ROS 2).")]
Domain = Annotated[int | None, Option(help="ROS domain (ROS 2).", show_default="the station's, or ROS_DOMAIN_ID, or 0")]
Master = Annotated[
    str | None,
    Option(metavar="URI", help="The master (ROS 1).", show_default="the station's, or http://127.0.0.1:11311"),
]


def network(
    topics: Topics,
    ros: int | None,
    interface: str | None,
    peer: list[str] | None,
    domain: int | None,
    master: str | None,
) -> Topics:
    """Return a station's topics on the network that a command line names."""
    if ros is not None and ros not in (1, 2):
        raise InvalidValue("--ros", ros, "give 1 or 2")
    if domain is not None and not 0 <= domain <= MAX_DOMAIN:
        raise InvalidValue("--domain", domain, f"give 0 to {MAX_DOMAIN}")
    given = {"ros": ros, "interface": interface, "peers": peer and tuple(peer), "domain": domain, "master": master}
    return replace(topics, **{name: value for name, value in given.items() if value is not None})


def serve(
    station: StationName,
    *,
    seed: Seed = 0,
    ros: Ros = None,
    interface: Interface = None,
    peer: Peer = None,
    domain: Domain = None,
    master: Master = None,
    speed: Annotated[float, Option(help="Seconds of the cell a second.")] = 1.0,
    seconds: Annotated[float | None, Option(help="End after this time of the cell; default: with Ctrl-C.")] = None,
) -> Result:
    """Be a robot that speaks CRTK over ROS 2 or 1: a simulated cell in real time, its cables' errors included."""
    need("sim")
    if seconds is not None and not seconds > 0:
        raise InvalidValue("--seconds", seconds, "give more than 0")
    from trocar.lab import load_station

    loaded = load_station(station)
    topics = network(loaded.crtk, ros, interface, peer, domain, master)
    from trocar.crtk.server import MAX_LATE_S, CrtkServer
    from trocar.lab.laboratory import build_cell
    from trocar.sim.pace import RealTime

    pace, laboratory = RealTime(speed, MAX_LATE_S), build_cell(loaded, seed=seed)
    server = CrtkServer(laboratory, topics, speed)
    names = ", ".join(topics.of_arm(name) for name in server.arms)
    beside().print(f"serving {names} over ROS {topics.ros} on {topics.interface}; Ctrl-C ends it")
    with contextlib.suppress(KeyboardInterrupt):
        laboratory.run(server.serve, seconds or float("inf"), pace)
    summary = {
        "station": station,
        "seconds": laboratory.now_s(),
        "received": {name: arm.received for name, arm in server.arms.items()},
        "commands": {name: dict(arm.counts) for name, arm in server.arms.items()},
        "limit_use": {name: laboratory.driver.limit_use(name) for name in server.arms},
        "events": laboratory.log.events,
    }
    told = ", ".join(f"{count} set-points for {name}" for name, count in summary["received"].items())
    return Result(summary, [f"served for {laboratory.now_s():.1f} s: {told}, {len(laboratory.log.events)} events"])
