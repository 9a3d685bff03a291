"""Images in bags become files, pixel by pixel, with stamps and lenses beside them."""

import json
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from made_bags import FORMS, START_S, camera_info, compressed, joints, raw, write_bag
from trocar.bags.images import cameras_in, write_images
from trocar.bags.reader import open_bag
from trocar.errors import BadFile, InvalidInput
from trocar.perception.image import Intrinsics

RNG = np.random.default_rng(0)
RGB = RNG.integers(0, 256, (5, 7, 3), dtype=np.uint8)
GREY = RGB[:, :, 0]
DEPTH_MM = RNG.integers(0, 65536, (5, 7), dtype=np.uint16)
DEPTH_M = RNG.normal(size=(5, 7)).astype(np.float32)
K, D = (900.0, 0, 3.1, 0, 901.0, 2.2, 0, 0, 1), (-0.2, 0.1, 0.001, 0.002, -0.3)


def written(tmp_path, topics, form="ros1", cameras=(), folder="images"):
    with open_bag(write_bag(tmp_path, form, topics)) as bag:
        return write_images(bag, tmp_path / folder, list(cameras))


def pixels(path):
    return np.load(path) if path.suffix == ".npy" else np.asarray(Image.open(path))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("given", "encoding", "expected"),
    [
        (RGB, "rgb8", RGB),
        (RGB[:, :, ::-1], "bgr8", RGB),
        (RGB[:, :, ::-1], "8UC3", RGB),
        (np.dstack([RGB, GREY]), "rgba8", RGB),
        (np.dstack([RGB[:, :, ::-1], GREY]), "bgra8", RGB),
        (GREY, "mono8", GREY),
        (DEPTH_MM, "16UC1", DEPTH_MM),
        (DEPTH_MM, "mono16", DEPTH_MM),
        (DEPTH_M, "32FC1", DEPTH_M),
    ],
)
def test_pixels_are_those_of_the_message(tmp_path, form, given, encoding, expected):
    messages = [raw(0.25, given, encoding), raw(0.5, given, encoding, padding=3, big=True)]
    (camera,) = written(tmp_path, {"/eye/image_raw": messages}, form)
    listed = json.loads(camera.list.read_text())
    assert camera.list == tmp_path / "images" / "eye_image_raw" / "images.json"
    assert [image["stamp_ns"] for image in listed["images"]] == [START_S * 10**9 + 250_000_000 * k for k in (1, 2)]
    for image in listed["images"]:
        found = pixels(camera.list.parent / image["file"])
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)
    assert (camera.images, camera.unstamped, camera.unknown, listed["frame"]) == (2, 0, {}, "eye")


@pytest.mark.parametrize("kind", ["png", "jpeg", "webp"])
def test_compressed_images_stay_as_they_are(tmp_path, kind):
    file = BytesIO()
    Image.fromarray(RGB).save(file, kind)
    (camera,) = written(tmp_path, {"/eye/compressed": [compressed(0.0, file.getvalue())]}, "mcap")
    (name,) = (image["file"] for image in json.loads(camera.list.read_text())["images"])
    assert (camera.list.parent / name).read_bytes() == file.getvalue()
    assert Image.open(camera.list.parent / name).format == kind.upper()


@pytest.mark.parametrize("form", FORMS)
def test_a_camera_has_the_lens_of_the_camera_info_beside_it(tmp_path, form):
    topics = {
        "/camera_info": [camera_info(0.0, (7, 5), (1.0, *K[1:]), D)],
        "/left/camera_info": [camera_info(0.0, (7, 5), K, D)],
        "/left/image_raw/compressed": [compressed(0.0, b"\xff\xd8\xff")],
        "/right/image_raw": [raw(0.0, RGB, "rgb8")],
    }
    left, right = written(tmp_path, topics, form)
    assert left.lens == Intrinsics(7, 5, 900.0, 901.0, 3.1, 2.2, D)
    assert right.lens is None
    listed = json.loads(left.list.read_text())
    assert Intrinsics(**{**listed["intrinsics"], "distortion": tuple(listed["intrinsics"]["distortion"])}) == left.lens


@pytest.mark.parametrize(
    ("k", "d", "model"),
    [
        (K, (*D, 0.1, 0.0, 0.0), "rational_polynomial"),
        (K, D[:4], "equidistant"),
        ((0.0,) * 9, (), "plumb_bob"),  # a camera that was never calibrated
    ],
)
def test_a_lens_that_is_not_browns_is_not_taken_for_one(tmp_path, k, d, model):
    topics = {"/eye/image": [raw(0.0, RGB, "rgb8")], "/eye/camera_info": [camera_info(0.0, (7, 5), k, d, model)]}
    (camera,) = written(tmp_path, topics)
    assert camera.lens is None and json.loads(camera.list.read_text())["intrinsics"] is None


def test_images_that_cannot_be_used_are_left_out_and_counted(tmp_path):
    messages = [raw(None, RGB, "rgb8"), raw(0.0, RGB, "bayer_rggb8"), raw(0.1, RGB, "rgb8"), compressed(0.0, b"?", "x")]
    kinds = {"/eye/image": messages[:3], "/eye/depth": messages[3:]}
    depth, eye = written(tmp_path, kinds)
    assert (eye.images, eye.unstamped, eye.unknown) == (1, 1, {"bayer_rggb8": 1})
    assert (depth.images, depth.unknown) == (0, {"x": 1})


def test_an_image_that_is_not_what_it_claims_is_one_sentence(tmp_path):
    kind, values = raw(0.0, RGB, "rgb8")
    with pytest.raises(InvalidInput, match="has an image of 7 x 6 pixels of rgb8 in 105 bytes of 21 a row"):
        written(tmp_path, {"/eye/image": [(kind, {**values, "height": 6})]})


def test_cameras_are_chosen_and_a_bag_without_any_says_so(tmp_path):
    topics = {f"/{name}/image": [raw(0.0, RGB, "rgb8")] for name in ("left", "right")}
    topics["/PSM1/measured_js"] = [joints(0.0, np.zeros(6))]
    with open_bag(write_bag(tmp_path, "ros1", topics)) as bag:
        assert cameras_in(bag) == ["/left/image", "/right/image"]
        (camera,) = write_images(bag, tmp_path / "one", ["/right/image"])
        assert camera.topic == "/right/image" and [f.name for f in (tmp_path / "one").iterdir()] == ["right_image"]
        with pytest.raises(InvalidInput, match="holds sensor_msgs/JointState"):
            write_images(bag, tmp_path / "two", ["/PSM1/measured_js"])
    with pytest.raises(InvalidInput, match="holds no images; leave --images out"):
        written(tmp_path, {"/PSM1/measured_js": topics["/PSM1/measured_js"]}, "mcap")


def test_an_earlier_import_is_replaced_and_other_peoples_files_are_not(tmp_path):
    two, one = ({"/eye/image": [raw(0.1 * k, RGB, "rgb8") for k in range(count)]} for count in (2, 1))
    (camera,) = written(tmp_path, two, "ros1")
    (camera.list.parent / "mine.txt").write_text("notes")
    written(tmp_path, one, "mcap")
    assert sorted(file.name for file in camera.list.parent.iterdir()) == ["000000.png", "images.json", "mine.txt"]
    (tmp_path / "full" / "eye_image").mkdir(parents=True)
    (tmp_path / "full" / "eye_image" / "000000.png").write_bytes(b"mine")
    with pytest.raises(BadFile, match=r"holds files, but no images.json of an earlier import; give another"):
        written(tmp_path, one, "sqlite", folder="full")
    assert (tmp_path / "full" / "eye_image" / "000000.png").read_bytes() == b"mine"
