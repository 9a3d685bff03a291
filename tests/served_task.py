"""Run as a program: serves the cell of one trial, with its blocks and its camera, and prints what the referee saw.

Arguments: JSON with ``task`` (options), ``seed``, ``domain``, ``ros``, ``master``, ``station`` (where the client's
station file is written), ``extra`` (lines of its table ``crtk``).
"""

import contextlib
import json
import signal
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import mujoco
import numpy as np
import trio

from trocar.crtk.bus import open_bus, stamped
from trocar.crtk.messages import CameraInfo, Empty, Image
from trocar.crtk.server import MAX_LATE_S, CrtkServer
from trocar.eval import TASKS
from trocar.eval.config import SESSION, TRIALS, RunConfig
from trocar.lab import station_text
from trocar.lab.session import draw_session
from trocar.lab.station_file import with_registered
from trocar.lab.topics import Topics
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.pace import RealTime

WHOLE = mujoco.mjtState.mjSTATE_INTEGRATION


LABORATORY = None
"""Of the process that renders, whose own copy of the cell gets the state of the served one."""


def laboratory_of(given):
    task = TASKS.pick("peg-transfer")(**given["task"])
    config = RunConfig(task, method="uncalibrated", seed=given["seed"])
    session = draw_session(config.laboratory, config.rng(0, SESSION))
    scene_rng, noise_rng, _ = map(np.random.default_rng, config.seeds(0, TRIALS, 0).spawn(3))
    return SimLaboratory(session, task.world(task.scene(scene_rng, config.laboratory)), noise_rng)


def prepare_rendering(given):
    global LABORATORY  # noqa: PLW0603
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    LABORATORY = laboratory_of(given)
    render(state_of(LABORATORY))


def state_of(laboratory):
    model = laboratory.world.model
    state = np.zeros(mujoco.mj_stateSize(model, WHOLE))
    mujoco.mj_getState(model, laboratory.world.data, state, WHOLE)
    return state


def render(state):
    model, data = LABORATORY.world.model, LABORATORY.world.data
    mujoco.mj_setState(model, data, state, WHOLE)
    mujoco.mj_forward(model, data)
    (camera,) = LABORATORY.cameras.values()
    image = camera.renderer.image(data, camera.rng)
    return image.depth_m.shape, image.color.tobytes(), image.depth_m.tobytes()


async def show(cell, laboratory, topics, pool):
    """Answer each request for an image with one of the cell as it is then."""
    bus = open_bus(topics)
    ((name, camera),) = cell.cameras.items()
    topic, lens = topics.of_camera(name), camera.model
    color = bus.publisher(f"{topic}/color/image_raw", Image)
    depth = bus.publisher(f"{topic}/depth/image_raw", Image)
    info = bus.publisher(f"{topic}/color/camera_info", CameraInfo, latched=True)
    info.send(CameraInfo(stamped(), lens.height, lens.width))
    trigger = bus.subscriber(f"{topic}/trigger", Empty)
    exposure_s = laboratory.session.station.cameras[name].exposure_s
    while True:
        if trigger.take():
            await cell.clock.sleep(exposure_s)
            header = stamped()
            rendered = pool.submit(render, state_of(laboratory))
            while not rendered.done():
                await cell.clock.sleep(0.01)
            (height, width), colors, depths = rendered.result()
            color.send(Image(header, height, width, "rgb8", 0, 3 * width, colors))
            depth.send(Image(header, height, width, "32FC1", 0, 4 * width, depths))
        await cell.clock.sleep(0.01)


def main(given):
    pool = ProcessPoolExecutor(1, get_context("spawn"), prepare_rendering, (given,))
    pool.submit(int).result()
    laboratory = laboratory_of(given)
    topics = Topics(ros=given.get("ros", 2), domain=given["domain"], master=given.get("master", Topics().master))
    text = with_registered(station_text("peg-transfer"), laboratory.session.T_world_base_registered)
    lines = [f"domain = {topics.domain}", f"ros = {topics.ros}", f'master = "{topics.master}"', *given.get("extra", [])]
    with open(given["station"], "w", encoding="utf-8") as file:
        file.write(text + "\n[crtk]\n" + "\n".join(lines) + "\n")
    server = CrtkServer(laboratory, topics)

    async def serve(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(server.serve, cell)
            nursery.start_soon(show, cell, laboratory, topics, pool)
            print("serving", flush=True)

    with contextlib.suppress(KeyboardInterrupt):
        laboratory.run(serve, 600.0, RealTime(1.0, MAX_LATE_S))
    pool.shutdown(cancel_futures=True)
    scores = laboratory.task.truth(laboratory.record())
    done = [bool(score.succeeded) for score in TASKS.pick("peg-transfer")(**given["task"]).score(scores, [])]
    uses = {name: laboratory.driver.limit_use(name) for name in server.arms}
    received = {name: arm.received for name, arm in server.arms.items()}
    print(json.dumps({"done": done, "limit_use": uses, "received": received, "events": laboratory.log.events}))


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    main(json.loads(sys.argv[1]))
