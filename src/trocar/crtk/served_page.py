"""The page of a served cell: it shows the cell live, in a process of its own."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from functools import partial
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from trocar.cell import Cell
from trocar.crtk.bus import open_bus
from trocar.crtk.images import color_of
from trocar.crtk.messages import Image
from trocar.crtk.served_cell import ServedCell
from trocar.eval.scenery import Scenery, contact_of
from trocar.lab.topics import Topics
from trocar.perception.image import StereoRig
from trocar.replay import painted
from trocar.robots import TICK_S
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.record import fixed_poses, solids_of
from trocar.view.live import ArmFacts, Moment
from trocar.view.live_page import Images, LivePage

EVERY_S = 0.04
"""Time between two moments, of the wall clock."""
STRONGEST_S = 0.1
"""A contact is told so much later, with its largest force until then."""
RATE_S = 1.0
"""Set-points are counted over this time."""


class ServedPage:
    """Shows a served cell: a context manager, whose page ends with it.

    Args:
        laboratory: the cell.
        served: who serves it.
        topics: namespaces, and the network on which images come.
        title: of the page.
        colours: of bodies, for people, by the beginning of their names.
        port: as ``LiveView`` takes it.
    """

    def __init__(
        self,
        laboratory: SimLaboratory,
        served: ServedCell,
        topics: Topics,
        title: str,
        colours: Mapping[str, tuple[float, float, float]],
        port: int = 8080,
    ):
        self._laboratory, self._served, self._topics = laboratory, served, topics
        self._told, self._touched_s = 0, -1.0
        self._refusals: dict[str, str] = {}
        self._received: dict[str, deque[tuple[float, int]]] = {name: deque() for name in served.arms}
        world, session = laboratory.world, laboratory.session
        scenery = Scenery(
            painted(solids_of(world), colours),
            fixed_poses(world),
            world.models,
            world.T_world_base,
            session.T_world_base_registered,
            cameras={},
            tick_s=TICK_S,
        )
        images = {
            name: f"{topics.of_camera(name)}/{'left' if isinstance(camera.renderer.model, StereoRig) else 'color'}"
            for name, camera in laboratory.cameras.items()
        }
        self._page = LivePage(scenery, title, self._moment(), port, partial(heard_images, topics, images))

    def __enter__(self) -> ServedPage:
        self._page.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._page.__exit__(kind, error, traceback)

    @property
    def address(self) -> str:
        """Return where a browser finds it."""
        return f"http://127.0.0.1:{self._page.port}"

    async def serve(self, cell: Cell) -> None:
        """Serve for ever."""
        due_s = 0.0
        while True:
            if time.monotonic() >= due_s and self._page.waits:
                due_s = time.monotonic() + EVERY_S
                self._page.show(self._moment())
            await cell.clock.sleep(TICK_S)

    def _moment(self) -> Moment:
        laboratory, now_s = self._laboratory, self._laboratory.now_s()
        events = laboratory.log.events[self._told :]
        self._told += len(events)
        for event in events:
            if event["name"] == "refused":
                self._refusals[str(event["arm"])] = f"{event['topic']}: {event['reason']}"
        until_s = now_s - STRONGEST_S
        touches = laboratory.contacts.collisions(self._touched_s, until_s)
        self._touched_s = until_s
        timely = self._served.timeliness()
        clock = f"{100 * timely.late_share:.2f} % of the ticks late, the latest by {1e3 * timely.latest_s:.0f} ms"
        return Moment(
            now_s,
            {name: row for name, row in laboratory.recorder.arrays(-1).items() if not name.startswith("desired_")},
            {name: self._facts(name) for name in self._served.arms},
            clock,
            tuple(events),
            tuple(contact_of(asdict(touch)) for touch in touches),
        )

    def _facts(self, name: str) -> ArmFacts:
        arm, now_s = self._served.arms[name], time.monotonic()
        state, homed, busy = arm.operating
        counts = self._received[name]
        counts.append((now_s, arm.received))
        while counts[0][0] < now_s - RATE_S:
            counts.popleft()
        (first_s, first), (last_s, last) = counts[0], counts[-1]
        rate = (last - first) / max(last_s - first_s, RATE_S)
        facts = {
            "speaks on": self._topics.of_arm(name),
            "commanded by": ", ".join(self._served.movers(name)) or "nobody",
            "set-points": f"{rate:.0f} a second, {arm.received} in all",
            "last refusal": self._refusals.get(name, "none"),
        }
        return ArmFacts(state, ", ".join(["homed" if homed else "not homed", *(["busy"] if busy else [])]), facts)


def heard_images(topics: Topics, names: Mapping[str, str]) -> Images:
    """Begin to listen for the images of cameras on these topics."""
    bus = open_bus(topics)
    heard = {name: bus.subscriber(f"{topic}/image_raw", Image, kept=1) for name, topic in names.items()}

    def come() -> Iterator[tuple[str, NDArray[np.uint8], str]]:
        for name, source in heard.items():
            for image in source.take():
                exposed_s = image.header.stamp.sec + 1e-9 * image.header.stamp.nanosec
                exposed = time.strftime("%H:%M:%S", time.localtime(exposed_s))
                yield name, color_of(image), f"exposed at {exposed}, came {time.time() - exposed_s:.2f} s later"

    return come
