"""The page of a served cell: it shows the cell live, in a process of its own."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

from trocar.cell import Cell
from trocar.crtk.bus import open_bus
from trocar.crtk.convert import seconds
from trocar.crtk.images import color_of, parts_of
from trocar.crtk.messages import Image
from trocar.crtk.served_cell import ServedCell
from trocar.eval.sight import SimSight
from trocar.lab.topics import Topics
from trocar.replay import painted
from trocar.robots import TICK_S
from trocar.sim.laboratory import SimLaboratory
from trocar.view.live import ArmFacts, Moment, Picture
from trocar.view.live_page import Images, LivePage

EVERY_S = 0.04
"""Time between two moments, of the wall clock."""
RATE_S = 1.0
"""Set-points are counted over this time."""


class ServedPage:
    """Shows a served cell: a context manager, whose page ends with it.

    Args:
        laboratory: the cell.
        served: its server.
        topics: namespaces, and the network on which images come.
        title: of the page.
        colours: of bodies, for people, by the beginning of their names.
    """

    def __init__(
        self,
        laboratory: SimLaboratory,
        served: ServedCell,
        topics: Topics,
        title: str,
        colours: Mapping[str, tuple[float, float, float]],
    ):
        self._sight, self._served, self._topics = SimSight(laboratory), served, topics
        self._refusals: dict[str, str] = {}
        self._received: dict[str, deque[tuple[float, int]]] = {name: deque() for name in served.arms}
        scenery = replace(self._sight.scenery, solids=painted(self._sight.scenery.solids, colours))
        images = {
            name: f"{topics.of_camera(name)}/{parts_of(camera.model)[0]}" for name, camera in laboratory.cameras.items()
        }
        self._page = LivePage(scenery, title, self._moment(), listen=partial(heard_images, topics, images))

    def __enter__(self) -> ServedPage:
        self._page.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._page.__exit__(None, None, None)

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
        seen = self._sight.look()
        for event in seen.events:
            if event["name"] == "refused":
                self._refusals[str(event["arm"])] = f"{event['topic']}: {event['reason']}"
        timely = self._served.timeliness()
        clock = f"{100 * timely.late_share:.2f} % of the ticks late, the latest by {1e3 * timely.latest_s:.0f} ms"
        facts = {name: self._facts(name) for name in self._served.arms}
        return Moment(seen.time_s, seen.arrays, facts, clock, seen.events, seen.contacts)

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

    def come() -> Iterator[Picture]:
        for name, source in heard.items():
            for image in source.take():
                exposed_s = seconds(image.header.stamp)
                exposed = time.strftime("%H:%M:%S", time.localtime(exposed_s))
                yield Picture(
                    name, color_of(image), f"exposed at {exposed}, came {time.time() - exposed_s:.2f} s later"
                )

    return come
