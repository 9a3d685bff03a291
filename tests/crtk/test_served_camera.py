"""A served camera answers a client in another process, and runs freely only until it is first asked."""

from types import SimpleNamespace

import numpy as np
import pytest
import trio

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from crtk_partners import DOMAIN, served
from memory_bus import MemoryBus
from trocar.crtk import served_camera
from trocar.crtk.bus import open_bus
from trocar.crtk.camera import CrtkCamera
from trocar.crtk.convert import seconds
from trocar.crtk.messages import Empty, Header, Image
from trocar.crtk.served_camera import ServedCameras
from trocar.errors import MachineError
from trocar.lab import load_station
from trocar.lab.laboratory import build_cell
from trocar.lab.topics import Topics

pytestmark = pytest.mark.realtime
TOPICS = Topics(domain=DOMAIN)
LENS = load_station("peg-transfer").cameras["overhead"].model
LIMIT_S = 60.0


@pytest.mark.parametrize(
    ("asked_s", "count"),
    [((0.0, 0.05), 1), ((0.0, 0.05, 0.1), 1), ((0.0, 0.13), 2), ((0.0, 0.05, 0.2), 2), ((0.0, 0.3), 2)],
)
def test_who_asks_while_an_image_is_exposed_gets_that_one_and_nobody_waits_for_another(monkeypatch, asked_s, count):
    bus, exposed = MemoryBus(), []
    monkeypatch.setattr(served_camera, "open_bus", lambda topics: bus)
    monkeypatch.setattr(ServedCameras, "_pending", lambda self: 0)
    laboratory = build_cell(load_station("peg-transfer"), seed=1)
    cameras, trigger = ServedCameras(laboratory, TOPICS, 0.0), bus.publisher("/overhead/trigger", Empty)

    async def script(cell):
        monkeypatch.setattr(cameras, "_expose", lambda *_, kept: exposed.append(cell.clock.now_s()))
        async with trio.open_nursery() as nursery:
            nursery.start_soon(cameras.serve, cell)
            began_s = cell.clock.now_s()
            for at_s in asked_s:
                await cell.clock.sleep(began_s + at_s - cell.clock.now_s())
                trigger.send(Empty())
            await cell.clock.sleep(0.5)
            nursery.cancel_scope.cancel()

    laboratory.run(script, 5.0)
    exposure_s = laboratory.cameras["overhead"].exposure_s
    assert len(exposed) == count
    assert all(any(0 <= at_s - asked <= 2 * exposure_s + 0.03 for at_s in exposed) for asked in asked_s)


def test_a_renderer_that_has_ended_is_named_and_takes_only_the_images_with_it(monkeypatch):
    monkeypatch.setattr(served_camera, "open_bus", lambda topics: MemoryBus())
    cameras = ServedCameras(build_cell(load_station("peg-transfer"), seed=1), TOPICS, 0.0)
    cameras._process = SimpleNamespace(join=lambda timeout: None, is_alive=lambda: False, exitcode=-9)
    cameras._theirs.close()
    for what in (cameras._pending, lambda: cameras._expose("overhead", Header(), b"", kept=True)):
        with pytest.raises(MachineError, match=r"the process that renders images has ended \(exit code -9\)"):
            what()
    assert cameras.files() == ({}, {}), "the trial is saved without them"


def test_a_renderer_that_does_not_get_ready_is_ended_and_named(monkeypatch):
    monkeypatch.setattr(served_camera, "open_bus", lambda topics: MemoryBus())
    monkeypatch.setattr(served_camera, "START_S", 0.0)
    cameras, done = ServedCameras(build_cell(load_station("peg-transfer"), seed=1), TOPICS, 0.0), []
    does = {name: lambda *_, name=name: done.append(name) for name in ("start", "kill", "join")}
    cameras._process = SimpleNamespace(**does)
    theirs, cameras._theirs = cameras._theirs, SimpleNamespace(close=lambda: None)
    with pytest.raises(MachineError, match="the process that renders images is not ready after 0 s"), cameras:
        pass
    assert done == ["start", "kill", "join"]
    theirs.close()


def test_a_served_camera_runs_freely_until_it_is_asked_and_then_answers_each_request_once():
    parts = {part: open_bus(TOPICS).subscriber(f"/overhead/{part}/image_raw", Image) for part in ("color", "depth")}
    came = {part: [] for part in parts}

    def take():
        for part, source in parts.items():
            came[part] += [seconds(message.header.stamp) for message in source.take()]

    async def until(holds):
        with trio.fail_after(LIMIT_S):
            while not holds():
                take()
                await trio.sleep(0.01)

    async def main():
        await until(lambda: len(came["depth"]) >= 2)  # nobody has asked
        camera = CrtkCamera("overhead", LENS, TOPICS)
        with trio.fail_after(LIMIT_S):
            while not camera._trigger.readers():
                await trio.sleep(0.01)
        images = [await camera.capture() for _ in range(3)]
        await until(lambda: len(set(came["color"]) & set(came["depth"])) >= 2 + len(images))
        return images

    with served("--domain", str(TOPICS.domain), "--images-hz", "5") as cell:
        images = trio.run(main)
        assert cell.poll() is None
    for image in images:
        assert image.color.shape == (LENS.height, LENS.width, 3)
        seen = np.isfinite(image.depth_m)  # only the arms: no task has put anything on the table
        assert seen.any() and image.color[seen].any()
    assert came["color"] == sorted(came["color"])
