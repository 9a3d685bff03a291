"""Bags of all kinds are opened alike; what is no bag, or a damaged one, is one sentence."""

import shutil

import numpy as np
import pytest

from made_bags import FORMS, START_S, compressed, joints, write_bag
from trocar.bags.reader import open_bag, stamp_ns
from trocar.errors import BadFile, InvalidInput

TOPICS = {
    "/PSM1/measured_js": [joints(0.01 * k, np.full(6, 0.1 * k)) for k in range(5)],
    "/eye/compressed": [compressed(0.0, b"\xff\xd8\xff rest")],
}


@pytest.mark.parametrize("form", FORMS)
def test_topics_and_messages_of_a_bag(tmp_path, form):
    with open_bag(write_bag(tmp_path, form, TOPICS)) as bag:
        assert bag.ros == (1 if form == "ros1" else 2)
        assert [(t.name, t.kind, t.messages) for t in bag.topics.values()] == [
            ("/PSM1/measured_js", "sensor_msgs/JointState", 5),
            ("/eye/compressed", "sensor_msgs/CompressedImage", 1),
        ]
        assert bag.start_ns == START_S * 10**9 and bag.duration_s == pytest.approx(0.04, abs=1e-12)
        found = list(bag.messages(["/PSM1/measured_js"]))
        assert [topic for topic, _ in found] == ["/PSM1/measured_js"] * 5
        assert [message.position[0] for _, message in found] == [0.1 * k for k in range(5)]
        assert [stamp_ns(message) for _, message in found] == [START_S * 10**9 + k * 10**7 for k in range(5)]


@pytest.mark.parametrize(("form", "suffix"), [("sqlite", "db3"), ("mcap", "mcap")])
def test_the_file_of_a_ros_2_bag_can_be_read_alone(tmp_path, form, suffix):
    (file,) = write_bag(tmp_path, form, TOPICS).glob(f"*.{suffix}")
    with open_bag(file) as bag:
        assert len(list(bag.messages(["/PSM1/measured_js"]))) == 5


def test_what_was_asked_of_a_topic_is_checked(tmp_path):
    with open_bag(write_bag(tmp_path, "ros1", TOPICS)) as bag:
        assert bag.topic("/eye/compressed", "sensor_msgs/CompressedImage").messages == 1
        with pytest.raises(InvalidInput, match="holds sensor_msgs/CompressedImage; name one of sensor_msgs/JointState"):
            bag.topic("/eye/compressed", "sensor_msgs/JointState")
        with pytest.raises(InvalidInput, match="did you mean '/PSM1/measured_js'"):
            bag.topic("/PSM1/measured", "sensor_msgs/JointState")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_a_bag_that_was_cut_off_is_one_sentence(tmp_path, form, share):
    path = write_bag(tmp_path, form, TOPICS)
    file = path if path.is_file() else next(file for file in path.iterdir() if file.suffix != ".yaml")
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    with pytest.raises(BadFile) as error, open_bag(path) as bag:
        list(bag.messages(list(bag.topics)))
    assert "\n" not in str(error.value) and "cannot be read" in str(error.value) and "reindex" in str(error.value)


def test_a_bag_with_a_damaged_message_says_so(tmp_path):
    (file,) = write_bag(tmp_path, "sqlite", TOPICS).glob("*.db3")
    file.write_bytes(file.read_bytes().replace(b"wrist_pitch", b"\xff\xfe\xfdst_pitch"))
    with pytest.raises(BadFile, match="cannot be read"), open_bag(file) as bag:
        list(bag.messages(["/PSM1/measured_js"]))


def test_what_is_no_bag_is_one_sentence(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("no bag")
    (tmp_path / "notes.bag").write_text("no bag")
    for name, said in {
        "nowhere.bag": "does not exist",
        "empty": "is a folder without metadata.yaml",
        "notes.txt": "does not end in .bag, .db3, .mcap",
        "notes.bag": "cannot be read",
    }.items():
        with pytest.raises(BadFile, match=said), open_bag(tmp_path / name):
            pass


def test_a_folder_that_lost_its_metadata_names_the_file_in_it(tmp_path):
    path = write_bag(tmp_path, "mcap", TOPICS)
    (path / "metadata.yaml").unlink()
    with (
        pytest.raises(BadFile, match=r"without metadata.yaml; give a file in it, such as bag_mcap.mcap"),
        open_bag(path),
    ):
        pass


@pytest.mark.parametrize("form", FORMS)
def test_an_empty_bag_is_refused(tmp_path, form):
    with pytest.raises(BadFile, match="holds no message"), open_bag(write_bag(tmp_path, form, {})):
        pass


def test_a_bag_of_before_iron_says_nothing_of_its_messages_and_is_read(tmp_path):
    """Such bags have no definitions in them; rosbags' writer does not write them any more, so they are taken out."""
    import sqlite3

    path = write_bag(tmp_path, "sqlite", TOPICS)
    (file,) = path.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("drop table message_definitions")
        database.execute("update topics set type_description_hash = ''")
        database.execute("update schema set schema_version = 3")
    with open_bag(file) as bag:
        assert len(list(bag.messages(["/PSM1/measured_js"]))) == 5


def test_reading_leaves_the_bag_as_it_was(tmp_path):
    path = write_bag(tmp_path, "sqlite", TOPICS)
    copy = shutil.copytree(path, tmp_path / "copy")
    with open_bag(copy) as bag:
        list(bag.messages(list(bag.topics)))
    before, after = ({file.name: file.read_bytes() for file in folder.iterdir()} for folder in (path, copy))
    assert before == after
