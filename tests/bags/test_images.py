"""Images in bags become files, pixel by pixel, with stamps and lenses beside them."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from made_bags import FORMS, START_S, camera_info, compressed, joints, packed, raw, write_bag
from trocar.bags import images as bag_images
from trocar.bags.images import cameras_in, write_images
from trocar.bags.reader import open_bag
from trocar.errors import BadFile, InvalidInput, MachineError
from trocar.files import output
from trocar.perception.image import Intrinsics

DOCS = Path(__file__).parents[2] / "docs" / "bags.md"
RNG = np.random.default_rng(0)
RGB = RNG.integers(0, 256, (5, 7, 3), dtype=np.uint8)
GREY = RGB[:, :, 0]
DEPTH_MM = RNG.integers(0, 65536, (5, 7), dtype=np.uint16)
DEPTH_M = RNG.normal(size=(5, 7)).astype(np.float32)
K, D = (900.0, 0, 3.1, 0, 901.0, 2.2, 0, 0, 1), (-0.2, 0.1, 0.001, 0.002, -0.3)
P = (800.0, 0, 3.3, -4.0, 0, 801.0, 2.4, 0, 0, 0, 1, 0)


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
    assert (camera.images, camera.unstamped, camera.unknown, camera.damaged) == (2, 0, {}, 0)
    assert listed["frame"] == "eye" and listed["complete"] is True


@pytest.mark.parametrize("kind", ["png", "jpeg", "webp"])
def test_compressed_images_stay_as_they_are(tmp_path, kind):
    content = packed(RGB, kind)
    (camera,) = written(tmp_path, {"/eye/compressed": [compressed(0.0, content)]}, "mcap")
    (name,) = (image["file"] for image in json.loads(camera.list.read_text())["images"])
    assert (camera.list.parent / name).read_bytes() == content
    assert Image.open(camera.list.parent / name).format == kind.upper()


@pytest.mark.parametrize("form", FORMS)
def test_a_camera_has_the_lens_of_the_camera_info_beside_it(tmp_path, form):
    topics = {
        "/camera_info": [camera_info(0.0, (7, 5), (1.0, *K[1:]), D)],
        "/left/camera_info": [camera_info(0.0, (7, 5), K, D)],
        "/left/image_raw/compressed": [compressed(0.0, packed(RGB, "jpeg"))],
        "/right/image_raw": [raw(0.0, RGB, "rgb8")],
    }
    left, right = written(tmp_path, topics, form)
    assert left.lens == Intrinsics(7, 5, 900.0, 901.0, 3.1, 2.2, D)
    assert right.lens is None
    listed = json.loads(left.list.read_text())
    assert Intrinsics(**{**listed["intrinsics"], "distortion": tuple(listed["intrinsics"]["distortion"])}) == left.lens


def test_the_lens_is_read_as_the_documentation_says(tmp_path, monkeypatch):
    topics = {"/left/image_raw": [raw(0.0, RGB, "rgb8")], "/left/camera_info": [camera_info(0.0, (7, 5), K, D)]}
    (camera,) = written(tmp_path, topics, folder="out/images")
    (example,) = (text for text in DOCS.read_text().split("```python\n") if "images.json" in text.split("```")[0])
    monkeypatch.chdir(tmp_path)
    found = {}
    exec(example.split("```")[0], found)
    assert found["lens"] == camera.lens and hash(found["lens"]) == hash(camera.lens)


@pytest.mark.parametrize(
    ("k", "d", "model"),
    [
        (K, (*D, 0.1, 0.0, 0.0), "rational_polynomial"),
        (K, D[:4], "equidistant"),
        ((0.0,) * 9, (), "plumb_bob"),  # a camera that was never calibrated
        ((np.nan, *K[1:]), D, "plumb_bob"),
        (K, (np.inf, *D[1:]), "plumb_bob"),
    ],
)
def test_a_lens_that_is_not_browns_is_not_taken_for_one(tmp_path, k, d, model):
    topics = {"/eye/image": [raw(0.0, RGB, "rgb8")], "/eye/camera_info": [camera_info(0.0, (7, 5), k, d, model)]}
    (camera,) = written(tmp_path, topics)
    assert camera.lens is None and json.loads(camera.list.read_text())["intrinsics"] is None


@pytest.mark.parametrize(
    ("topic", "expected"),
    [
        ("/eye/image_rect_color", Intrinsics(7, 5, 800.0, 801.0, 3.3, 2.4)),
        ("/eye/image_rect/compressed", Intrinsics(7, 5, 800.0, 801.0, 3.3, 2.4)),
        ("/eye/image_raw", Intrinsics(7, 5, 900.0, 901.0, 3.1, 2.2, D)),
        ("/rect/image_direct", Intrinsics(7, 5, 900.0, 901.0, 3.1, 2.2, D)),
    ],
)
def test_rectified_images_have_the_lens_that_rectified_them_without_distortion(tmp_path, topic, expected):
    image = compressed(0.0, packed(RGB, "png")) if topic.endswith("/compressed") else raw(0.0, RGB, "rgb8")
    info = f"/{topic.split('/')[1]}/camera_info"
    (camera,) = written(tmp_path, {topic: [image], info: [camera_info(0.0, (7, 5), K, D, p=P)]})
    assert camera.lens == expected


def test_a_rectified_image_needs_no_lens_of_browns(tmp_path):
    info = camera_info(0.0, (7, 5), K, D[:4], "equidistant", p=P)
    (camera,) = written(tmp_path, {"/eye/image_rect": [raw(0.0, RGB, "rgb8")], "/eye/camera_info": [info]})
    assert camera.lens == Intrinsics(7, 5, 800.0, 801.0, 3.3, 2.4)


def test_the_lens_is_that_of_the_pixels_that_were_read_out(tmp_path):
    """Half of a sensor of 28 x 10 pixels from (10, 0) on, 2 x 2 of them combined: as Intrinsics itself says it."""
    k = (900.0, 0, 13.0, 0, 901.0, 6.0, 0, 0, 1)
    info = camera_info(0.0, (28, 10), k, D, binning=(2, 2), roi=(10, 0, 14, 10))
    (camera,) = written(tmp_path, {"/eye/image": [raw(0.0, RGB, "rgb8")], "/eye/camera_info": [info]})
    assert camera.lens == Intrinsics(28, 10, 900.0, 901.0, 13.0, 6.0, D).cropped((10, 0), (14, 10)).binned(2)


def test_a_lens_for_images_of_another_size_is_none(tmp_path):
    topics = {"/eye/image": [raw(0.0, RGB, "rgb8")], "/eye/camera_info": [camera_info(0.0, (14, 10), K, D)]}
    (camera,) = written(tmp_path, topics)
    assert camera.lens is None and json.loads(camera.list.read_text())["intrinsics"] is None


def test_a_lens_is_the_first_that_a_driver_knew(tmp_path):
    infos = [camera_info(0.1 * n, (7, 5), k, D) for n, k in enumerate(([0.0] * 9, K, [2 * one for one in K]))]
    (camera,) = written(tmp_path, {"/eye/image": [raw(0.0, RGB, "rgb8")], "/eye/camera_info": infos})
    assert camera.lens is not None and camera.lens.fx == K[0]


def test_images_that_cannot_be_used_are_left_out_and_counted(tmp_path):
    messages = [raw(None, RGB, "rgb8"), raw(0.0, RGB, "bayer_rggb8"), raw(0.1, RGB, "rgb8"), raw(0.2, RGB, "")]
    depth, eye = written(tmp_path, {"/eye/image": messages, "/eye/depth": [compressed(0.0, b"?", "x")]})
    assert (eye.images, eye.unstamped, eye.unknown) == (1, 1, {"bayer_rggb8": 1, "": 1})
    assert (depth.images, depth.unknown) == (0, {"x": 1})


def test_images_that_are_not_what_they_claim_are_left_out_and_counted(tmp_path):
    kind, values = raw(0.0, RGB, "rgb8")
    nothing = {**values, "height": 0, "data": np.zeros(0, np.uint8)}
    wrong = [{**values, "height": 6}, nothing, {**values, "step": 20}, {**values, "width": 0}]
    rows = [(kind, fields) for fields in wrong]
    topics = {
        "/a/image": [*rows[:2], raw(0.1, RGB, "rgb8"), *rows[2:]],
        "/b/compressed": [compressed(0.0, b"\xff\xd8\xff")],
    }
    eye, cut = written(tmp_path, topics)
    assert (eye.images, eye.damaged, cut.images, cut.damaged) == (1, 4, 0, 1)
    assert [image["file"] for image in json.loads(eye.list.read_text())["images"]] == ["000000.png"]


@pytest.mark.parametrize("kind", ["png", "jpeg", "webp"])
def test_compressed_images_that_were_cut_off_are_left_out_and_counted(tmp_path, kind):
    """A driver that died while it wrote leaves the header, from which alone the size could be read."""
    noise = np.random.default_rng(5).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    whole = packed(noise, kind)
    contents = [whole[: len(whole) // 2], whole, whole[: 9 * len(whole) // 10]]
    (camera,) = written(tmp_path, {"/eye/compressed": [compressed(0.1 * n, c) for n, c in enumerate(contents)]})
    assert (camera.images, camera.damaged) == (1, 2)


def test_topics_that_would_share_a_folder_are_refused_and_repeated_ones_written_once(tmp_path):
    topics = {name: [raw(0.0, RGB, "rgb8")] for name in ("/left/image", "/left_image")}
    with pytest.raises(
        InvalidInput, match="topics /left/image and /left_image would both be written into 'left_image'"
    ):
        written(tmp_path, topics)
    (camera,) = written(tmp_path, topics, "mcap", ["/left_image", "/left_image"])
    assert camera.topic == "/left_image"


def test_an_import_that_was_interrupted_says_so(tmp_path, monkeypatch):
    topics = {"/eye/image": [raw(0.1 * k, RGB, "rgb8") for k in range(3)]}
    (camera,) = written(tmp_path, topics)
    assert json.loads(camera.list.read_text())["complete"]
    asked = []

    def fails(message):
        asked.append(message)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return whole(message)

    whole = bag_images._picture
    monkeypatch.setattr(bag_images, "_picture", fails)
    with pytest.raises(KeyboardInterrupt):
        written(tmp_path, topics, "mcap")
    listed = json.loads(camera.list.read_text())
    assert (listed["complete"], listed["images"]) == (False, [])
    assert sorted(file.name for file in camera.list.parent.iterdir()) == ["000000.png", "images.json"]
    monkeypatch.undo()
    assert written(tmp_path, topics, "sqlite")[0].images == 3
    assert json.loads(camera.list.read_text())["complete"]


def test_a_draft_of_an_import_that_was_killed_at_once_is_not_in_the_way(tmp_path):
    (tmp_path / "images" / "eye_image").mkdir(parents=True)
    (tmp_path / "images" / "eye_image" / ".trocar-1-0.part.json").write_text("{")
    (camera,) = written(tmp_path, {"/eye/image": [raw(0.0, RGB, "rgb8")]})
    assert sorted(file.name for file in camera.list.parent.iterdir()) == ["000000.png", "images.json"]


def test_a_folder_is_looked_through_no_more_often_for_more_images(tmp_path, monkeypatch):
    """Otherwise the time grows with the square of their number."""
    scans, scandir = [], output.os.scandir
    monkeypatch.setattr(output.os, "scandir", lambda path=".": scans.append(str(path)) or scandir(path))
    for count, form in ((1, "ros1"), (30, "mcap")):
        written(tmp_path, {"/eye/image": [raw(0.1 * k, RGB, "rgb8") for k in range(count)]}, form, folder=f"to_{form}")
    few, many = (scans.count(str(tmp_path / f"to_{form}" / "eye_image")) for form in ("ros1", "mcap"))
    assert many == few > 0


def test_a_disk_that_is_full_is_the_machines_trouble(tmp_path, monkeypatch):
    def full(path, content):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(MachineError, match=r"cannot write .*000000.png.* .No space left on device"):
        written(tmp_path, {"/eye/image": [raw(0.0, RGB, "rgb8")]})


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
