"""Bags of all kinds are opened alike; what is no bag, or a damaged one, is one sentence."""

import bz2
import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1

from made_bags import FORMS, ROS1, ROS2, START_S, compressed, joints, message, write_bag
from trocar.bags.reader import open_bag, stamp_ns
from trocar.errors import BadFile, InvalidInput, MachineError

TOPICS = {
    "/PSM1/measured_js": [joints(0.01 * k, np.full(6, 0.1 * k)) for k in range(5)],
    "/eye/compressed": [compressed(0.0, b"\xff\xd8\xff rest")],
}


def read(path, topic="/PSM1/measured_js"):
    """Return how many messages a bag has of a topic."""
    with open_bag(path) as bag:
        return len(list(bag.messages([topic])))


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
    assert read(file) == 5


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
    tool = {"ros1": "rosbag reindex", "sqlite": "ros2 bag reindex", "mcap": "mcap recover"}[form]
    assert "\n" not in str(error.value) and "cannot be read" in str(error.value)
    assert str(error.value).endswith(f"if it was cut off, mend a copy with {tool}")


def test_a_bag_with_a_damaged_message_says_so(tmp_path):
    (file,) = write_bag(tmp_path, "sqlite", TOPICS).glob("*.db3")
    file.write_bytes(file.read_bytes().replace(b"wrist_pitch", b"\xff\xfe\xfdst_pitch"))
    with pytest.raises(BadFile, match="cannot be read"), open_bag(file) as bag:
        list(bag.messages(["/PSM1/measured_js"]))


def test_what_is_no_bag_is_one_sentence(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("no bag")
    (tmp_path / "notes.bag").write_text("no bag")
    (tmp_path / "run.bag.active").write_text("#ROSBAG V2.0")
    for name, said in {
        "nowhere.bag": "does not exist",
        "empty": "is a folder without metadata.yaml",
        "notes.txt": "does not end in .bag, .db3, .mcap",
        "notes.bag": "cannot be read",
        "run.bag.active": "was not closed; .* run rosbag reindex on a copy and rename it to run.bag",
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
    path = write_bag(tmp_path, "sqlite", TOPICS)
    (file,) = path.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("drop table message_definitions")
        database.execute("update topics set type_description_hash = ''")
        database.execute("update schema set schema_version = 3")
    assert read(file) == 5


@pytest.mark.parametrize("name", ["run1.bag", "run1.db3", "what? #1 100%20.d"])
@pytest.mark.parametrize("form", ["sqlite", "mcap"])
def test_a_folder_may_have_any_name(tmp_path, form, name):
    path = write_bag(tmp_path, form, TOPICS).rename(tmp_path / name)
    assert read(path) == 5
    for file in (file for file in path.iterdir() if file.suffix != ".yaml"):
        assert read(file.rename(tmp_path / f"what? #1 100%20{file.suffix}")) == 5


@pytest.mark.parametrize("alone", [True, False])
def test_messages_that_are_not_yet_in_the_database_are_not_lost(tmp_path, alone):
    path = write_bag(tmp_path, "sqlite", TOPICS)
    (file,) = path.glob("*.db3")
    with closing(sqlite3.connect(file)) as database:
        database.execute("pragma journal_mode=wal")
        database.execute("insert into messages select null, topic_id, timestamp + 1, data from messages")
        database.commit()
        with pytest.raises(
            BadFile, match=r"only in .*-wal' beside it; on a copy of both, run: sqlite3 bag_sqlite.db3 "
        ):
            read(file if alone else path)
        database.execute("pragma wal_checkpoint(truncate)")
        assert read(file if alone else path) == 10


STRANGE = "float64 x\r\n# a comment\r\n%% what is this\r\n"


def write_strange(path, own_kind="sensor_msgs/msg/JointState", md5sum=None):
    """Write a bag of ROS 1 with five good messages, and topics of strange definitions."""
    with Writer1(path) as writer:
        kind, fields = joints(0.0, np.zeros(6))
        raw = message(ROS1, kind, fields)
        good = writer.add_connection("/PSM1/measured_js", kind, typestore=ROS1)
        text, digest = ROS1.generate_msgdef(own_kind)
        others = [
            writer.add_connection("/strange", "my_msgs/msg/Strange", msgdef=STRANGE, md5sum="0" * 32),
            writer.add_connection("/other", own_kind, msgdef=text, md5sum=md5sum or digest),
        ]
        for k in range(5):
            writer.write(good, START_S * 10**9 + k, raw)
        for other in others:
            writer.write(other, START_S * 10**9, raw)
    return path


def test_topics_that_nobody_asked_for_may_be_strange(tmp_path):
    path = write_strange(tmp_path / "a.bag", md5sum="1" * 32)
    assert read(path) == 5
    with pytest.raises(InvalidInput, match=r"'/strange' .* holds my_msgs/Strange; only ROS's own kinds of messages"):
        read(path, "/strange")
    with pytest.raises(
        InvalidInput, match=r"'/other' .* holds sensor_msgs/JointState of another definition than ROS's"
    ):
        read(path, "/other")
    assert read(write_strange(tmp_path / "b.bag", md5sum="*"), "/other") == 1


def test_definitions_in_a_database_do_not_matter(tmp_path):
    """ROS 2 writes the encoding ``unknown`` for a kind whose definition it does not find."""
    path = write_bag(tmp_path, "sqlite", TOPICS)
    (file,) = path.glob("*.db3")
    with closing(sqlite3.connect(file)) as database:
        database.execute("update message_definitions set encoding = 'unknown', encoded_message_definition = ''")
        database.commit()
    assert read(file) == read(path) == 5


def write_mcap(path, profile="ros2", **options):
    """Write an MCAP with five joints backwards in time and five messages that are not ROS's own."""
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start(profile)
        kind, fields = joints(0.0, np.zeros(6))
        raw = message(ROS2, kind, fields)
        known = writer.register_channel("/PSM1/measured_js", "cdr", writer.register_schema(kind, "ros2msg", b"?"))
        others = {
            "/json": ("json", writer.register_schema("sensor_msgs/msg/JointState", "jsonschema", b"{}")),
            "/protobuf": ("protobuf", writer.register_schema("Scene", "protobuf", b"\xff\xfe")),
            "/nothing": ("json", 0),
        }
        numbers = [known, *(writer.register_channel(name, *about) for name, about in others.items())]
        for k in range(5):
            at_ns = START_S * 10**9 - k
            for number in numbers:
                writer.add_message(number, at_ns, raw if number == known else b"{}", at_ns)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"use_chunking": False},
        {"use_statistics": False},
        {"repeat_channels": False},
        {"repeat_schemas": False},
        {"index_types": IndexType.NONE, "compression": CompressionType.LZ4},
        {
            "use_chunking": False,
            "use_statistics": False,
            "use_summary_offsets": False,
            "repeat_channels": False,
            "repeat_schemas": False,
        },
    ],
)
def test_channels_of_an_mcap_that_are_not_ros_2s_do_not_matter(tmp_path, options):
    with open_bag(write_mcap(tmp_path / "a.mcap", **options)) as bag:
        assert {topic.name: (topic.kind, topic.messages) for topic in bag.topics.values()} == {
            "/PSM1/measured_js": ("sensor_msgs/JointState", 5),
            "/json": ("sensor_msgs/JointState (json)", 5),
            "/protobuf": ("Scene (protobuf)", 5),
            "/nothing": ("(json)", 5),
        }
        assert (bag.start_ns, bag.duration_s) == (START_S * 10**9 - 4, 4e-9)
        assert len(list(bag.messages(["/PSM1/measured_js"]))) == 5
        assert bag.of_kind("sensor_msgs/JointState") == [bag.topics["/PSM1/measured_js"]]
        with pytest.raises(InvalidInput, match=r"holds sensor_msgs/JointState \(json\); only ROS's own kinds"):
            list(bag.messages(["/json"]))


@pytest.mark.parametrize(
    ("profile", "said"),
    [
        ("ros1", "holds messages of ROS 1; give the .bag from which it was made"),
        ("", "has no profile, where messages of ROS 2 have 'ros2'"),
        ("x-mine", "has the profile 'x-mine', where"),
    ],
)
def test_an_mcap_of_something_else_says_what_it_is(tmp_path, profile, said):
    with pytest.raises(BadFile, match=said), open_bag(write_mcap(tmp_path / "a.mcap", profile)):
        pass


@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        (OSError(28, "No space left on device"), r"cannot be read \(No space left on device\); see to the machine"),
        (PermissionError(13, "Permission denied"), r"cannot be read \(Permission denied\)"),
        (MemoryError(), "needs more memory than there is"),
    ],
)
@pytest.mark.parametrize("form", FORMS)
def test_the_machines_trouble_is_not_the_bags(tmp_path, monkeypatch, form, trouble, said):
    path = write_bag(tmp_path, form, TOPICS)

    def fails(self, mode="r", *_, **__):
        raise trouble

    file = path if path.is_file() else next(file for file in path.iterdir() if file.suffix != ".yaml")
    monkeypatch.setattr("pathlib.Path.open", fails)
    with pytest.raises(MachineError, match=said), open_bag(file):
        pass


def test_damaged_bytes_are_not_the_machines_trouble(tmp_path, monkeypatch):
    """The decompressor of bz2 raises OSError for them."""
    monkeypatch.setattr("rosbags.rosbag1.reader.decompressors", {"none": lambda raw: bz2.decompress(b"no bz2")})
    with pytest.raises(BadFile, match=r"cannot be read \(Invalid data stream\)"):
        read(write_bag(tmp_path, "ros1", TOPICS))


def test_reading_leaves_the_bag_as_it_was(tmp_path):
    path = write_bag(tmp_path, "sqlite", TOPICS)
    copy = shutil.copytree(path, tmp_path / "copy")
    with open_bag(copy) as bag:
        list(bag.messages(list(bag.topics)))
    before, after = ({file.name: file.read_bytes() for file in folder.iterdir()} for folder in (path, copy))
    assert before == after
