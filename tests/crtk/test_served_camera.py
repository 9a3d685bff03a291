"""A served camera answers a client in another process, and runs freely only until it is first asked."""

import os

import numpy as np
import pytest
import trio

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from crtk_partners import served
from trocar.crtk.bus import open_bus
from trocar.crtk.camera import CrtkCamera
from trocar.crtk.convert import seconds
from trocar.crtk.messages import Image
from trocar.lab import load_station
from trocar.lab.topics import Topics

pytestmark = pytest.mark.realtime
TOPICS = Topics(domain=40 + os.getpid() % 150)
LENS = load_station("peg-transfer").cameras["overhead"].model
LIMIT_S = 60.0


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
