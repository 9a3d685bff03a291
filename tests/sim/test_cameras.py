"""One eye or two, each with its own lens, place and lamp; their windows and their noise."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trio

from simulated import STATION, ideal_session
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.lab import SensorFlaws, load_station
from trocar.perception.image import Intrinsics, StereoImage, StereoRig, StereoWindow, Window
from trocar.sim.cameras import STEREO_GAINS, CameraRenderer
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.ray_camera import RayCamera
from trocar.sim.sensor import Light

CAMERA = STATION.cameras["overhead"]


@pytest.mark.parametrize("flaws", [None, SensorFlaws.none()])
def test_an_eye_has_the_cameras_flaws_or_those_it_is_given(flaws):
    bare = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom type="plane" size="1 1 .1"/></worldbody></mujoco>')
    lens, place = Intrinsics(24, 16, 30.0, 30.0, 11.5, 7.5), SE3.from_parts(SO3.exp([3.0, 0.1, 0.2]), [0.1, 0.2, 0.5])
    (eye,) = CameraRenderer(bare, replace(CAMERA, model=lens), place, flaws).lenses
    assert eye.flaws == (flaws or CAMERA.flaws) and CAMERA.flaws != SensorFlaws.none()
    assert (eye.light.ambient, eye.light.gain) == (CAMERA.ambient, CAMERA.gain)


def test_the_right_eye_is_a_little_darker_than_the_left_which_is_as_its_camera():
    left, right = STEREO_GAINS
    assert left == 1.0 and 0.9 < right < 0.99
    assert np.isfinite(STEREO_GAINS).all()


@pytest.fixture
def pair():
    """A laboratory of two eyes without flaws and with few pixels, and their camera."""
    station = load_station("raven-pair")
    camera = station.cameras["stereo"]
    left, right = camera.model.left.binned(4), camera.model.right.binned(4)
    right = replace(right, fx=1.02 * right.fx, fy=1.02 * right.fy)  # or else nobody would see them swapped
    camera = replace(camera, model=StereoRig(left, right, camera.model.T_left_right))
    day = ideal_session(replace(station, cameras={"stereo": camera}))
    return SimLaboratory(day, rng=np.random.default_rng(0), flaws=SensorFlaws.none()), camera


def test_the_right_eye_sees_from_its_own_place_under_the_same_lamp(pair):
    lab, camera = pair
    rig = camera.model

    async def script(cell):
        await cell.cameras["stereo"].capture()

    assert lab.run(script, 5.0)
    (image,) = lab.cameras["stereo"].taken
    assert isinstance(image, StereoImage) and image.rig is rig
    assert image.time_s == lab.now_s() == pytest.approx(0.033, abs=0.011)
    assert image.left.shape == image.right.shape == (240, 320, 3)
    assert (np.abs(image.left.astype(int) - image.right).max(axis=-1) > 30).mean() > 0.02, "two pictures"
    light = Light(ambient=camera.ambient, gain=camera.gain)
    eyes = ((rig.left, SE3.identity()), (rig.right, rig.T_left_right))
    for (lens, T_left_eye), picture, gain in zip(eyes, (image.left, image.right), STEREO_GAINS, strict=True):
        lamp_m, T_world_eye = T_left_eye.inverse().apply(camera.lamp_m), camera.T_world_camera @ T_left_eye
        alone = RayCamera(lab.world.model, lens, T_world_eye, lamp_m, SensorFlaws.none(), light)
        assert picture.std() > 5
        assert np.array_equal(alone.render_color(lab.world.data, np.random.default_rng(0), gain), picture)


def test_a_window_is_read_out_and_not_kept(pair):
    lab, camera = pair
    rig = camera.model
    window = StereoWindow(Window((60, 20), (200, 150)), Window((20, 20), (180, 150)))
    seen = {}

    async def script(cell):
        eyes = cell.cameras["stereo"]
        seen["whole"] = await eyes.capture()
        seen["part"] = await eyes.capture(window)
        seen["binned"] = await eyes.capture(replace(window, binning=2))
        before_s = cell.clock.now_s()
        with pytest.raises(TrocarError, match="leaves the image"):
            await eyes.capture(StereoWindow(Window((300, 0), (100, 50)), Window((0, 0), (100, 50))))
        with pytest.raises(TrocarError, match="give a StereoWindow"):
            await eyes.capture(Window((0, 0), (100, 50)))
        assert cell.clock.now_s() == before_s, "what is refused takes no time"

    lab.run(script, 5.0)
    part, whole, binned = seen["part"], seen["whole"], seen["binned"]
    assert lab.cameras["stereo"].taken == [whole]
    assert part.rig == window.of(rig)
    assert binned.rig == replace(window, binning=2).of(rig) and binned.left.shape == (75, 100, 3)
    blocks = part.left.reshape(75, 2, 100, 2, 3).mean(axis=(1, 3))
    assert np.abs(binned.left[4:-4, 4:-4] - blocks[4:-4, 4:-4]).mean() < 2.0
    inner = np.s_[4:-4, 4:-4]  # the lens blurs across a window's border
    assert np.array_equal(part.left[inner], whole.left[20:170, 60:260][inner])
    assert np.array_equal(part.right[inner], whole.right[20:170, 20:200][inner])


def test_a_laboratorys_generator_draws_its_cameras_noise():
    """None stands for the first seed; another one makes another noise."""

    async def script(cell):
        await cell.cameras["overhead"].capture()

    small = replace(CAMERA, model=CAMERA.model.binned(8))
    day, noise = ideal_session(replace(STATION, cameras={"overhead": small})), []
    for rng in (None, np.random.default_rng(0), np.random.default_rng(1)):
        lab = SimLaboratory(day, rng=rng)
        lab.run(script, 5.0)
        noise.append(lab.cameras["overhead"].taken[0].color.tobytes())
    assert noise[0] == noise[1] != noise[2]


def test_a_projector_lights_one_exposure_at_a_time():
    small = replace(CAMERA, model=CAMERA.model.binned(8))
    lab = SimLaboratory(ideal_session(replace(STATION, cameras={"overhead": small})))

    async def script(cell):
        async with trio.open_nursery() as nursery:
            for _ in range(3):
                nursery.start_soon(cell.cameras["overhead"].capture)

    lab.run(script, 5.0)
    taken_s = [image.time_s for image in lab.cameras["overhead"].taken]
    exposure_s = lab.cameras["overhead"].exposure_s
    assert np.diff([0.0, *taken_s]) == pytest.approx(exposure_s, abs=0.011)
