"""``trocar recording``: what a bag holds, and what becomes of it."""

import json

import numpy as np
import pytest

from made_bags import FORMS, START_S, joints, raw, write_bag
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import load_recording

RNG = np.random.default_rng(0)
Q = np.clip(np.cumsum(RNG.normal(0, 0.08, (80, 6)), axis=0), -1, 1) * [1, 1, 0.1, 1, 1, 1] + [0, 0, 0.15, 0, 0, 0]
TRUE = PSM1_GREY.measure(PSM1_GREY.run(Q), RNG)
TOPICS = {
    "/PSM1/setpoint_js": [joints(0.8 * k, q) for k, q in enumerate(Q)],
    "/PSM1/measured_js": [joints(0.8 * k + 0.01, q) for k, q in enumerate(Q)],
    "/tracker/measured_js": [joints(0.8 * k + 0.5, q) for k, q in enumerate(TRUE)],
    "/eye/image_raw": [raw(0.1, np.zeros((4, 6, 3), np.uint8), "rgb8"), raw(None, np.zeros((4, 6)), "rgb8")],
}
TOPICS["/eye/image_raw"].append(raw(0.2, np.zeros((4, 6), np.uint8), "rgb8"))


@pytest.mark.parametrize("form", FORMS)
def test_a_bag_becomes_a_cable_model(trocar, tmp_path, form):
    bag, out = write_bag(tmp_path, form, TOPICS), tmp_path / "psm1.npz"
    words = ("recording", "import", bag, "--measured", "/tracker/measured_js", "--out", out)
    code, text, _ = trocar(*words)
    assert code == 0
    assert f"{out}: 80 rows over 63.2 s, commanded by /PSM1/setpoint_js, measured by /tracker/measured_js" in text
    assert "warning" not in text
    code, said, _ = trocar(*words, "--json")
    said = json.loads(said)["recording"]
    assert (said["rows"], said["valid"], said["encoders"], said["start_ns"]) == (80, 80, False, START_S * 10**9)
    recording = load_recording(out)
    np.testing.assert_array_equal(recording.q_cmd, Q)
    np.testing.assert_array_equal(recording.q_phy, TRUE)
    code, text, _ = trocar("calibrate", "fit", out, "--out", tmp_path / "model.npz")
    assert code == 0 and "fitted play on 80 rows" in text


def test_encoders_are_warned_of_and_everything_left_out_is_said(trocar, tmp_path):
    sent = [joints(None, Q[0]), joints(1.0, Q[1]), joints(2.0, Q[2]), joints(1.5, Q[3]), joints(2.5, Q[4], names=())]
    seen = [joints(0.5, Q[0]), joints(1.1, []), joints(1.2, Q[1]), joints(3.0, Q[4]), joints(3.5, Q[4] + 1.5)]
    seen.append(joints(3.6, Q[4][:5]))
    bag = write_bag(tmp_path, "mcap", {"/PSM1/servo_jp": sent, "/PSM1/measured_js": seen})
    code, text, _ = trocar("recording", "import", bag, "--out", tmp_path / "a.npz", "--settled", "0.4")
    assert code == 0
    for line in (
        "beside each measurement is the last command before it; 2 rows of commands in between have none",
        "/PSM1/servo_jp: 1 message with a stamp of 0 (not valid), left out",
        "/PSM1/servo_jp: 1 message with an earlier stamp than the one before, put in order",
        "/PSM1/servo_jp: 1 message without names of joints, taken as q1 to q6",
        "/PSM1/measured_js: 1 message without finite positions, left out",
        "/PSM1/measured_js: 1 message of other joints, or without a position for each name, left out",
        "1 measurement before the first command, left out",
        "1 measurement during or too soon after a motion, marked as not valid",
        "1 measurement with a wrist angle 1 rad or more from its command, marked as not valid",
        "warning: by their topic, the measurements are those of the arm's encoders",
    ):
        assert line in text
    assert load_recording(tmp_path / "a.npz").valid.tolist() == [False, False, False, True, False]
    code, said, _ = trocar("recording", "import", bag, "--out", tmp_path / "a.npz", "--json")
    assert json.loads(said)["recording"]["left_out"]["/PSM1/measured_js"] == {"unstamped": 0, "empty": 1, "unfit": 1}


def test_images_are_written_with_and_without_a_recording(trocar, tmp_path):
    bag = write_bag(tmp_path, "sqlite", TOPICS)
    code, text, _ = trocar("recording", "import", bag, "--images", tmp_path / "images")
    assert code == 0
    assert f"{tmp_path / 'images' / 'eye_image_raw'}: 1 image of /eye/image_raw, without a lens" in text
    assert "/eye/image_raw: 1 image with a stamp of 0, left out" in text
    assert "/eye/image_raw: 1 image of other bytes than it claims, left out" in text
    words = ("--images", tmp_path / "images", "--out", tmp_path / "a.npz", "--camera", "/eye/image_raw", "--json")
    said = json.loads(trocar("recording", "import", bag, *words)[1])
    assert said["recording"]["rows"] == 80 and [(one["images"], one["damaged"]) for one in said["images"]] == [(1, 1)]


@pytest.mark.parametrize("form", FORMS)
def test_what_a_bag_holds(trocar, tmp_path, form):
    bag = write_bag(tmp_path, form, TOPICS)
    code, text, _ = trocar("recording", "show", bag)
    assert code == 0
    assert f"{bag}: 4 topics of ROS {1 if form == 'ros1' else 2} over 0.8 s" in text
    assert "/tracker/measured_js  sensor_msgs/JointState        80  101.3 Hz" in text
    assert "arms with commands and measurements: /PSM1; cameras: /eye/image_raw" in text
    said = json.loads(trocar("recording", "show", bag, "--json")[1])
    assert said["topics"]["/eye/image_raw"] == {
        "kind": "sensor_msgs/Image",
        "messages": 3,
        "rate_hz": pytest.approx(3 / 0.79),
    }
    assert (said["arms"], said["cameras"]) == (["/PSM1"], ["/eye/image_raw"])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "the import has nothing to write; give --out, --images or both"),
        (("--out", "a.csv"), "must end in .npz"),
        (("--out", "a.npz", "--settled", "-1"), "--settled is -1.0; give seconds, 0 or more"),
        (("--out", "a.npz", "--settled", "nan"), "--settled is nan"),
        (
            ("--out", "a.npz", "--namespace", "/PSM3"),
            "'/PSM3/setpoint_js' is unknown; did you mean '/PSM1/setpoint_js'",
        ),
        (("--out", "a.npz", "--measured", "/eye/image_raw"), "holds sensor_msgs/Image"),
        (("--out", "a.npz", "--joints", "a,b"), "does not name six joints"),
        (
            ("--out", "a.npz", "--namespace", "/PSM1", "--commanded", "/PSM1/measured_js"),
            "topic '/PSM1/measured_js' cannot be commanded and measured at once",
        ),
        (("--out", "a.npz", "--camera", "/eye/image_raw"), "--camera has no effect without --images; drop --camera"),
        (("--images", "images", "--measured", "/PSM1/measured_js"), "--measured has no effect without --out"),
        (("--images", "images", "--settled", "0.5"), "--settled has no effect without --out"),
        (("--images", "images", "--camera", "/eye/image"), "'/eye/image' is unknown; did you mean '/eye/image_raw'"),
        (("--images", "bag.bag"), "is a file; give a folder"),
    ],
)
def test_what_cannot_be_imported_is_one_sentence(trocar, tmp_path, monkeypatch, words, said):
    bag = write_bag(tmp_path, "ros1", TOPICS)
    monkeypatch.chdir(tmp_path)
    code, out, err = trocar("recording", "import", bag, *words)
    assert (code, out) == (2, "") and said in err and err.count("\n") == 1
    assert [file.name for file in tmp_path.iterdir()] == ["bag.bag"]
