"""``trocar crtk``: simulate a robot that speaks CRTK, and diagnose one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from typer import Option

from trocar.cli.group import Result
from trocar.cli.options import Plugins, Seed, StationName, TaskOptions, need
from trocar.cli.out_folder import default_folder
from trocar.cli.terminal import beside, rich_table
from trocar.counting import counted
from trocar.errors import InvalidInput, InvalidValue
from trocar.files.output import write_text
from trocar.lab.topics import MAX_DOMAIN, Topics

if TYPE_CHECKING:
    from trocar.crtk.served_cell import ServedCell
    from trocar.eval import Task
    from trocar.lab import Station
    from trocar.lab.session import Session
    from trocar.sim.laboratory import SimLaboratory
    from trocar.sim.pace import Script

Ros = Annotated[int | None, Option(help="1 or 2.", show_default="the station's, or 2")]
Interface = Annotated[
    str | None, Option(help="Address of the network interface.", show_default="the station's, or 127.0.0.1")
]
Peer = Annotated[list[str] | None, Option(metavar="HOST", help="Another machine to speak with (ROS 2); repeatable.")]
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
    task: Annotated[str, Option(help="Lay out this task; a referee scores what is done.", show_default="none")] = "",
    option: TaskOptions = None,
    spheres: Annotated[
        list[str] | None,
        Option(metavar="ARM", help="Let this arm wear spheres, over an empty table, for a calibration; repeatable."),
    ] = None,
    seed: Seed = 0,
    session: Annotated[int, Option(min=0, help="Number of the session in a run of this seed.")] = 0,
    trial: Annotated[int, Option(min=0, help="Number of the trial in the session.")] = 0,
    out: Annotated[
        Path | None,
        Option(metavar="DIR", help="Folder for the trial's files.", show_default="out/served-TASK-SEED-OPTIONS"),
    ] = None,
    client_station: Annotated[
        Path | None,
        Option(
            metavar="FILE",
            help="Where to write the station as registered in this session, for the client.",
            show_default="station.toml in --out",
        ),
    ] = None,
    fault: Annotated[
        list[str] | None,
        Option(metavar="ARM:KIND[=VALUE][@TIMEs]", help="Plant a fault, such as psm1:stale@20s; repeatable."),
    ] = None,
    allow: Annotated[
        list[str] | None,
        Option(
            metavar="CLIENT",
            help="Who may command: a ROS node, an address, localhost, or *; repeatable.",
            show_default="* on the loopback interface, else nobody",
        ),
    ] = None,
    view: Annotated[bool, Option("--view", help="Show the cell live, on a page for this machine's browsers.")] = False,
    images_hz: Annotated[float, Option(help="Images a second of a camera until it is triggered; 0: none.")] = 1.0,
    ros: Ros = None,
    interface: Interface = None,
    peer: Peer = None,
    domain: Domain = None,
    master: Master = None,
    speed: Annotated[float, Option(help="Simulated seconds per real second.")] = 1.0,
    seconds: Annotated[
        float | None, Option(help="Stop after this many simulated seconds; default: with Ctrl-C.")
    ] = None,
    plugin: Plugins = None,
) -> Result:
    """Be a robot that speaks CRTK over ROS 2 or 1: a simulated cell in real time, its cables' errors included.

    With --task, its objects lie on the table as in the same trial of `trocar run`. At the end, whatever ends it, the
    referee scores what any client did to them, and the trial is kept with its replay and pictures, as those of a run.
    With --spheres, the table is empty, and `trocar calibrate collect --robot` can calibrate an arm from images.
    """
    need("sim", *(["view"] if view else []))
    if seconds is not None and not seconds > 0:
        raise InvalidValue("--seconds", seconds, "give more than 0")
    given = {"--option": option, "--trial": trial, "--out": out}
    for flag, value in given.items():
        if value and not task:
            raise InvalidInput(flag, "has no effect without --task", f"drop {flag}, or add --task")
    if spheres and task:
        raise InvalidInput("--spheres", "are worn over an empty table, and --task lays one out", "drop one of them")
    from trocar.lab import load_station

    loaded = load_station(station)
    topics = network(loaded.crtk, ros, interface, peer, domain, master)
    from trocar.crtk.bus import domain_of

    if topics.ros == 2:
        topics = replace(topics, domain=domain_of(topics))
    from trocar.crtk.faults import fault_of
    from trocar.crtk.served_cell import ServedCell

    faults = [fault_of(text, list(loaded.arms)) for text in fault or ()]
    referee, chosen, folder = None, None, out
    if task:
        from trocar.crtk.referee import Referee
        from trocar.eval import TASKS
        from trocar.eval.method import make_task

        folder = out or default_folder(f"served-{task}-{seed}", {"station": station, "option": option or []})
        chosen = make_task(TASKS.pick(task), option or ())
        referee = Referee(chosen, station, seed, session, trial, folder)
    laboratory = referee.staged.laboratory if referee else _laboratory(loaded, seed, session, spheres or ())
    if client_station is None and folder is not None:
        client_station = folder / "station.toml"
    drawn = laboratory.session
    if client_station is not None:
        _write_station(client_station, station, drawn, topics)
    title = f"{task or station}, seed {seed}, live"
    with (
        ServedCell(laboratory, topics, speed, images_hz, faults=faults, allowed=allow or ()) as served,
        _page(laboratory, served, topics, title if view else "", chosen) as scripts,
    ):
        names = ", ".join(
            [topics.of_arm(name) for name in served.arms] + list(map(topics.of_camera, drawn.station.cameras))
        )
        beside().print(f"serving {names} over ROS {topics.ros} on {topics.interface}; Ctrl-C ends it", soft_wrap=True)
        if client_station is not None:
            beside().print(f"a client's station: {client_station}", soft_wrap=True)
        end = served.run(seconds or float("inf"), scripts)
        images = served.files() if referee else ({}, {})
    time = served.timeliness()
    summary = {
        "station": station,
        "seconds": laboratory.now_s(),
        "received": {name: arm.received for name, arm in served.arms.items()},
        "commands": {name: dict(arm.counts) for name, arm in served.arms.items()},
        "limit_use": {name: laboratory.driver.limit_use(name) for name in served.arms},
        "refused": dict(served.refused),
        "events": laboratory.log.events,
        "time": asdict(time),
    }
    told = ", ".join(f"{count} set-points for {name}" for name, count in summary["received"].items())
    lines: list[Any] = [
        f"served for {laboratory.now_s():.1f} s: {told}, {len(laboratory.log.events)} events",
        f"{100 * time.late_share:.2f} % of the ticks were late by a tick or more, the latest by "
        f"{1e3 * time.latest_s:.0f} ms; {100 * time.core_share:.0f} % of a core",
    ]
    lines += [f"refused: {count} commands of {client}" for client, count in served.refused.items()]
    if referee is not None:
        judged, shown = _judged(referee.save(end, images))
        summary, lines = summary | judged, [shown[0], *lines, *shown[1:]]
    return Result(summary, lines)


def _laboratory(station: Station, seed: int, session: int, wearing: Sequence[str]) -> SimLaboratory:
    """Return a laboratory without a task, in a session of a run.

    Args:
        station: station of the laboratory.
        seed: the run's seed.
        session: the session's number.
        wearing: arms that wear spheres; if there are any, the cell has an empty table.
    """
    from trocar.eval.config import SESSION
    from trocar.lab.session import draw_session
    from trocar.perception.fiducial_joints import require_psm
    from trocar.perception.fiducials import SIX_SPHERES
    from trocar.sim.calibration_cells import EmptyTable, printed
    from trocar.sim.laboratory import SimLaboratory

    for name in wearing:
        require_psm(station.arm(name).model)
    rng = np.random.default_rng([seed, session, SESSION])
    drawn = draw_session(station, rng)
    fixtures = {name: printed(SIX_SPHERES, rng) for name in wearing}
    return SimLaboratory(drawn, EmptyTable() if wearing else None, rng, fixtures=fixtures)


@contextmanager
def _page(
    laboratory: SimLaboratory, served: ServedCell, topics: Topics, title: str, task: Task | None
) -> Iterator[list[Script]]:
    """Open a page in the task's colours, unless the title is empty, and yield the scripts that feed it."""
    if not title:
        yield []
        return
    from trocar.crtk.served_page import ServedPage
    from trocar.report.files import task_report

    with ServedPage(laboratory, served, topics, title, task_report(task).colours if task else {}) as page:
        beside().print(f"watch it: {page.address} in a browser", soft_wrap=True)
        yield [page.serve]


def _write_station(path: Path, station: str, session: Session, topics: Topics) -> None:
    """Write a station as registration found it in a session, with its topics and network."""
    from trocar.lab import station_text
    from trocar.lab.station_file import with_registered, with_topics

    cameras = {
        name: (session.T_world_camera_registered[name], camera.model_registered)
        for name, camera in session.station.cameras.items()
    }
    text = with_registered(station_text(station), session.T_world_base_registered, cameras)
    write_text(path, with_topics(text, topics), "station")


def _judged(path: Path) -> tuple[dict[str, Any], list[Any]]:
    """Draw a saved trial's replay and pictures; return its summary, and the table and sentences to print."""
    from trocar.eval.trials import Trials
    from trocar.report.files import report_of, write_report
    from trocar.report.tables import headline, run_table

    beside().print(f"saved: {path}", soft_wrap=True)  # before the pictures, which take seconds
    trials = Trials([path])
    found, files = write_report(path.parent.parent, trials, into=path.with_suffix(""))
    report = report_of(trials[0])
    table = run_table(found, report.paper_rows(found), report.paper_count(found))
    told = [table, headline(found), "files: " + ", ".join(map(str, [path, *files]))]
    return {"trial": str(path), "summary": found}, told


def doctor(
    station: StationName,
    *,
    seconds: Annotated[float, Option(help="How long to listen.")] = 5.0,
    ros: Ros = None,
    interface: Interface = None,
    peer: Peer = None,
    domain: Domain = None,
    master: Master = None,
) -> Result:
    """Listen to a robot that speaks CRTK, and tell what is wrong with it; nothing is commanded.

    Exit code 1: a check fails.
    """
    if not 1 <= seconds <= 3600:
        raise InvalidValue("--seconds", seconds, "give 1 to 3600")
    from trocar.lab import load_station

    found = load_station(station)
    topics = network(found.crtk, ros, interface, peer, domain, master)
    from trocar.crtk.bus import open_bus
    from trocar.crtk.doctor import Verdict, examine_arm, examine_camera
    from trocar.crtk.listening import Listener, listen
    from trocar.hardware.priority import ahead_of_others

    beside().print(f"listening for {seconds:g} s over ROS {topics.ros} on {topics.interface}", soft_wrap=True)
    listener = Listener(open_bus(topics), found, topics, list(found.arms), list(found.cameras))
    with ahead_of_others():  # a listener that is delayed cannot tell how late messages are
        heard = listen(listener, seconds)
    checks = [check for arm in found.arms for check in examine_arm(heard, found, topics, arm)]
    checks += [check for camera in found.cameras for check in examine_camera(heard, found, topics, camera)]
    failed = [check for check in checks if check.verdict is Verdict.FAIL]
    rows = [(check.of, check.name, check.verdict.value, check.found) for check in checks]
    end = f"{counted(len(failed), 'check')} of {len(checks)} failed" if failed else "nothing is wrong"
    lines = [
        rich_table(f"{station}, {seconds:g} s", ("who", "check", "verdict", "what was found"), rows, text=4),
        *map(str, failed),
        end,
    ]
    values = [{**asdict(check), "verdict": check.verdict.value} for check in checks]
    return Result({"station": station, "checks": values, "failed": len(failed)}, lines, succeeded=not failed)
