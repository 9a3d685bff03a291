"""A camera on the network that answers well, late or not at all."""

import threading
import time

import numpy as np
import pytest
import trio

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from cyclonedds.core import Policy, Qos
from cyclonedds.pub import DataWriter
from cyclonedds.util import duration

from crtk_partners import DOMAIN
from trocar.crtk import camera as camera_module
from trocar.crtk.bus import open_bus, stamped
from trocar.crtk.camera import CrtkCamera, ImageFault, NoImage
from trocar.crtk.images import color_message, depth_message, info_message
from trocar.crtk.messages import CameraInfo, Empty, Image
from trocar.errors import InvalidInput
from trocar.lab.topics import Topics
from trocar.perception.image import Intrinsics, Window

pytestmark = pytest.mark.realtime
TOPICS = Topics(domain=DOMAIN)
LENS = Intrinsics(8, 6, 10.0, 10.0, 3.5, 2.5)
COLOR = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
DEPTH_M = np.linspace(0.1, 0.5, 48, dtype=np.float32).reshape(6, 8)


class Partner:
    """A camera of the same name; ``answer`` is called at each trigger with the time, and sends what it likes."""

    def __init__(self, name, answer, lens=LENS):
        bus = open_bus(TOPICS)
        self.info = bus.publisher(f"/{name}/color/camera_info", CameraInfo, latched=True)
        self.color = bus.publisher(f"/{name}/color/image_raw", Image)
        self.depth = bus.publisher(f"/{name}/depth/image_raw", Image)
        self.trigger = bus.subscriber(f"/{name}/trigger", Empty)
        self.info.send(info_message(lens, "color", stamped()))
        self._answer = answer

    async def run(self):
        while True:
            if self.trigger.take():
                self._answer(self, time.time())
            await trio.sleep(0.005)

    def send(self, color_s=None, depth_s=None):
        if color_s is not None:
            self.color.send(color_message(COLOR, stamped("", color_s)))
        if depth_s is not None:
            self.depth.send(depth_message(DEPTH_M, stamped("", depth_s)))


def captured(name, answer, window=None):
    partner = Partner(name, answer)
    camera = CrtkCamera(name, LENS, TOPICS)
    taken, raised = [], []

    async def main():
        async with trio.open_nursery() as nursery:
            nursery.start_soon(partner.run)
            with trio.fail_after(30.0):
                while not (partner.color.readers() and partner.depth.readers() and camera._trigger.readers()):
                    await trio.sleep(0.01)
            try:
                taken.append(await camera.capture(window))
            except NoImage as error:
                raised.append(error)
            nursery.cancel_scope.cancel()

    trio.run(main)
    if raised:
        raise raised[0]
    return taken[0]


def test_an_image_is_the_first_whose_parts_were_exposed_together_after_the_request():
    def answer(partner, now_s):
        partner.send(now_s - 1.0, now_s - 1.0)  # it ran freely
        partner.send(now_s + 0.01)
        partner.send(now_s + 0.02, now_s + 0.02)

    image = captured("well", answer)
    assert np.array_equal(image.color, COLOR) and np.array_equal(image.depth_m, DEPTH_M)


def test_a_window_is_cut_out():
    window = Window((2, 1), (3, 4))
    image = captured("window", lambda partner, now_s: partner.send(now_s, now_s), window)
    assert np.array_equal(image.color, COLOR[1:5, 2:5]) and np.array_equal(image.depth_m, DEPTH_M[1:5, 2:5])


@pytest.mark.parametrize("sure", [Policy.Reliability.Reliable(duration(seconds=1)), Policy.Reliability.BestEffort])
def test_a_camera_that_keeps_nothing_for_late_readers_or_sends_nothing_again_is_heard(sure):
    """As many camera drivers publish over ROS 2: volatile, best-effort."""
    name = f"plain_{type(sure).__name__.lower()}"
    bus = open_bus(TOPICS)
    quality = Qos(sure, Policy.Durability.Volatile, Policy.History.KeepLast(5))
    info, color, depth = (
        DataWriter(bus._participant, bus._topic(f"/{name}/{what}", kind), qos=quality)
        for what, kind in (("color/camera_info", CameraInfo), ("color/image_raw", Image), ("depth/image_raw", Image))
    )
    ended, taken = threading.Event(), []

    def publish():
        while not ended.wait(0.03):
            info.write(info_message(LENS, "color", stamped()))
            now_s = time.time()
            color.write(color_message(COLOR, stamped("", now_s)))
            depth.write(depth_message(DEPTH_M, stamped("", now_s)))

    running = threading.Thread(target=publish)
    running.start()
    try:
        camera = CrtkCamera(name, LENS, TOPICS)

        async def take():
            taken.append(await camera.capture())

        trio.run(take)
    finally:
        ended.set()
        running.join()
    assert np.array_equal(taken[0].color, COLOR)


@pytest.mark.parametrize(
    ("fault", "answer"),
    [
        (ImageFault.SILENT, lambda partner, now_s: None),
        (ImageFault.OLD, lambda partner, now_s: partner.send(now_s - 1.0, now_s - 1.0)),
        (ImageFault.AHEAD, lambda partner, now_s: partner.send(now_s + 1.0, now_s + 1.0)),
        (ImageFault.HALF, lambda partner, now_s: partner.send(now_s + 0.01)),
        (ImageFault.HALF, lambda partner, now_s: partner.send(now_s + 0.01, now_s + 0.02)),
    ],
)
def test_a_camera_without_an_answer_says_why(fault, answer, monkeypatch):
    monkeypatch.setattr(camera_module, "ANSWER_S", 1.0)
    with pytest.raises(NoImage) as raised:
        captured(f"bad_{fault.name.lower()}", answer)
    assert (raised.value.camera, raised.value.fault) == (f"bad_{fault.name.lower()}", fault)


def test_a_camera_of_another_size_or_without_a_lens_is_not_connected(monkeypatch):
    kept = Partner("other", lambda *_: None, Intrinsics(4, 3, 10.0, 10.0, 1.5, 1.0))
    with pytest.raises(InvalidInput, match="publishes 4 x 3 pixels, and the station says 8 x 6"):
        CrtkCamera("other", LENS, TOPICS)
    assert kept
    monkeypatch.setattr(camera_module, "CONNECT_S", 0.3)
    with pytest.raises(InvalidInput, match=r"publishes no /nobody/color/camera_info within 0\.3 s"):
        CrtkCamera("nobody", LENS, TOPICS)
