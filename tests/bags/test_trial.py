"""A trial as MCAP: what another reader finds in it, and that our own import reads it back."""

import json
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from made_bags import packed
from synthetic import TICK_S, config, synthetic_trial
from trocar.arms import fk
from trocar.bags.images import write_images
from trocar.bags.joints import Choice, choose, read_recording
from trocar.bags.reader import open_bag
from trocar.bags.trial import START_NS, write_mcap
from trocar.errors import InvalidInput
from trocar.geometry import SE3
from trocar.lab import load_station
from trocar.log import Span

ROWS = 200
AT = START_NS


DEPTH_MM = np.arange(12, dtype=np.uint16).reshape(3, 4) * 300


@pytest.fixture(scope="module")
def trial():
    """Two seconds with an image of the whole view of the camera, and one of a part of it; bases registered 1 mm off."""
    whole = synthetic_trial(config(), failures={1: "DROPPED"})
    lens = load_station("peg-transfer").cameras["overhead"].model_registered
    moved = SE3.from_parts(translation_m=[1e-3, 0.0, 0.0])
    bases = {name: T @ moved for name, T in whole.scenery.T_world_base.items()}
    cameras = {"overhead": [(0.5, "a.webp"), (1.5, "b.webp")]}
    depth = np.zeros((lens.height // 4, lens.width // 4), np.uint16)
    blobs = {
        "a.webp": packed(np.zeros((lens.height, lens.width, 3), np.uint8), "webp"),
        "a_depth.png": packed(depth, "png"),
        "b.webp": packed(np.zeros((12, 16, 3), np.uint8), "webp"),
        "b_depth.png": packed(DEPTH_MM, "png"),
    }
    return replace(
        whole,
        arrays={name: rows[:ROWS] if len(rows) > 4 else rows for name, rows in whole.arrays.items()},
        spans=[Span("psm1", "motion", 0.5, 1.0), Span("psm1", "jaw", 0.75, 1.25), Span("psm2", "capture", 0.0, 0.1)],
        events=[{"name": "transfer", "time_s": 1.5, "outcome": "DROPPED", "goal": 1}, {"name": "look", "time_s": 0.25}],
        scores=whole.scores[:2],
        images=blobs,
        scenery=replace(whole.scenery, cameras=cameras, T_world_base=bases),
    )


@pytest.fixture(scope="module")
def file(trial, tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "trial.mcap"
    write_mcap(trial, path)
    return path


@pytest.fixture(scope="module")
def found(file):
    """Messages by topic as (time in ns, message), read by the library of MCAP's authors."""
    topics = {}
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        for _, channel, record, message in reader.iter_decoded_messages():
            topics.setdefault(channel.topic, []).append((record.log_time, message))
    return topics


def stamps(messages):
    return [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for _, message in messages]


@pytest.mark.parametrize(
    ("key", "word"), [("desired", "desired"), ("commanded", "setpoint"), ("measured", "measured"), ("true", "true")]
)
def test_joints_jaws_and_tips_of_every_kind(trial, found, key, word):
    rows = trial.arrays[f"{key}_psm1"].astype(np.float64)
    joints, jaws, tips = (found[f"/PSM1/{name}"] for name in (f"{word}_js", f"jaw/{word}_js", f"{word}_cp"))
    expected_ns = [AT + round(1e9 * TICK_S * k) for k in range(ROWS)]
    assert stamps(joints) == stamps(jaws) == stamps(tips) == [at for at, _ in joints] == expected_ns
    assert_array_equal([message.position for _, message in joints], rows[:, :6])
    assert_array_equal([message.position for _, message in jaws], rows[:, 6:])
    assert list(joints[0][1].name) == ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"]
    assert list(jaws[0][1].name) == ["jaw"]
    bases = trial.scenery.T_world_base if key == "true" else trial.scenery.T_world_base_registered
    T = bases["psm1"] @ fk(trial.scenery.arms["psm1"], rows[:, :6])
    places = [[m.pose.position.x, m.pose.position.y, m.pose.position.z] for _, m in tips]
    turns = [[getattr(m.pose.orientation, part) for part in "wxyz"] for _, m in tips]
    assert_allclose(places, T.translation_m, atol=1e-12)
    assert_allclose(np.abs(np.sum(turns * T.rotation.as_quaternion(), axis=1)), 1.0, atol=1e-12)
    assert {m.header.frame_id for _, m in tips} == {"world"}


def test_bodies_move_as_they_truly_did(trial, found):
    names = {t.child_frame_id for t in found["/tf"][0][1].transforms}
    assert {"block0", "psm1_link1", "psm1_link6", "psm2_finger_left"} <= names and "board" not in names
    blocks = [t for _, m in found["/tf"] for t in m.transforms if t.child_frame_id == "block0"]
    places = [[b.transform.translation.x, b.transform.translation.y, b.transform.translation.z] for b in blocks]
    assert_allclose(places, trial.arrays["body_block0"][:, :3].astype(float), atol=1e-12)
    assert {b.transform.rotation.w for b in blocks} == {1.0} and {b.header.frame_id for b in blocks} == {"world"}
    ((at_ns, fixed),) = found["/tf_static"]
    assert at_ns == AT and {t.child_frame_id for t in fixed.transforms} == {"board", "overhead"}
    camera = load_station("peg-transfer").cameras["overhead"].T_world_camera
    (overhead,) = [t.transform for t in fixed.transforms if t.child_frame_id == "overhead"]
    assert [getattr(overhead.rotation, part) for part in "wxyz"] == pytest.approx(camera.rotation.as_quaternion())


def test_every_frame_of_a_solid_is_known(found):
    ((at_ns, scene),) = found["/scene"]
    frames = {t.child_frame_id for name in ("/tf", "/tf_static") for t in found[name][0][1].transforms} | {"world"}
    assert at_ns == AT and {marker.header.frame_id for marker in scene.markers} <= frames
    assert len({(marker.ns, marker.id) for marker in scene.markers}) == len(scene.markers)


def test_spans_are_what_was_under_way(found):
    said = [((at - AT) / 1e9, message.data) for at, message in found["/PSM1/span"]]
    assert said == [(0.0, ""), (0.5, "motion"), (0.75, "motion, jaw"), (1.0, "jaw"), (1.25, "")]


def test_events_scores_collisions_and_the_end_are_in_the_log(trial, found):
    noted = [((at - AT) / 1e9, m.level, m.name, json.loads(m.msg)) for at, m in found["/log"]]
    assert [one[:3] for one in noted] == [
        (0.25, 20, "look"),
        (1.5, 30, "transfer"),
        (3.0, 30, "referee: collision"),
        (5.0, 20, "referee: transfer"),
        (10.0, 30, "referee: transfer"),
        (60.0, 20, "end"),
    ]
    assert noted[1][3] == {"outcome": "DROPPED", "goal": 1}
    assert noted[2][3]["against"] == "peg 4"
    assert noted[4][3]["goal"] == 1 and noted[4][3]["failure"] == "DROPPED"


def test_images_stay_as_they_are_and_only_whole_ones_have_the_lens(trial, found):
    images = found["/overhead/image/compressed"]
    assert [bytes(message.data) for _, message in images] == [trial.images["a.webp"], trial.images["b.webp"]]
    assert [message.format for _, message in images] == ["webp", "webp"]
    ((at_ns, info),) = found["/overhead/camera_info"]
    lens = load_station("peg-transfer").cameras["overhead"].model_registered
    assert at_ns == AT + 500_000_000 and (info.width, info.height) == (lens.width, lens.height)
    assert_array_equal(np.reshape(info.k, (3, 3)), lens.matrix)
    assert tuple(info.d) == lens.distortion and info.distortion_model == "plumb_bob"


def test_depth_is_in_millimetres_and_its_lens_that_of_every_fourth_pixel(found):
    whole, part = (message for _, message in found["/overhead/depth/image"])
    assert (part.encoding, part.height, part.width, part.step) == ("16UC1", 3, 4, 8)
    assert_array_equal(np.frombuffer(bytes(part.data), "<u2").reshape(3, 4), DEPTH_MM)
    ((at_ns, info),) = found["/overhead/depth/camera_info"]
    assert at_ns == AT + 500_000_000 and (info.width, info.height) == (whole.width, whole.height)
    lens = load_station("peg-transfer").cameras["overhead"].model_registered
    assert_allclose(np.reshape(info.k, (3, 3)), np.diag([0.25, 0.25, 1.0]) @ lens.matrix)


def test_a_station_that_has_changed_gives_no_lens(trial, tmp_path):
    for about in ({"station": "nowhere.toml"}, {"station_digest": "0"}):
        counts = write_mcap(replace(trial, about={**trial.about, **about}), tmp_path / "other.mcap")
        assert "/overhead/camera_info" not in counts and counts["/overhead/image/compressed"] == 2


def test_our_import_reads_it_back_exactly(trial, file, tmp_path):
    with open_bag(file) as bag:
        assert bag.ros == 2
        choice = choose(bag, "PSM2", measured="/PSM2/true_js")
        assert choice == Choice("/PSM2/setpoint_js", "/PSM2/true_js")
        recording = read_recording(bag, choice).recording
        depth, camera = write_images(bag, tmp_path, [])
    assert_array_equal(recording.q_cmd, trial.arrays["commanded_psm2"][:, :6].astype(np.float64))
    assert_array_equal(recording.q_phy, trial.arrays["true_psm2"][:, :6].astype(np.float64))
    assert recording.valid.all()
    assert_allclose(recording.t_s, trial.times_s[:ROWS], atol=1e-9)
    assert_array_equal(np.asarray(Image.open(depth.list.parent / "000001.png")), DEPTH_MM)
    assert (camera.list.parent / "000001.webp").read_bytes() == trial.images["b.webp"]
    assert camera.lens == load_station("peg-transfer").cameras["overhead"].model_registered


def test_the_same_trial_is_the_same_bytes_and_other_peoples_files_stay(trial, file, tmp_path):
    write_mcap(trial, tmp_path / "again.mcap")
    assert (tmp_path / "again.mcap").read_bytes() == file.read_bytes()
    write_mcap(trial, tmp_path / "again.mcap")
    (tmp_path / "mine.mcap").write_bytes(b"\x89MCAP0\r\n of mine")
    with pytest.raises(InvalidInput, match="is not a recording of a trial that Trocar wrote"):
        write_mcap(trial, tmp_path / "mine.mcap")
