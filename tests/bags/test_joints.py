"""Recordings from bags: which topics, which rows, which order of the joints, and what is left out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from made_bags import FORMS, PSM, joints, write_bag
from trocar.bags.joints import Choice, arms_in, choose, read_recording
from trocar.bags.reader import open_bag
from trocar.calibration.recording import load_recording
from trocar.errors import InvalidInput

CHOICE = Choice("/PSM1/setpoint_js", "/tracker/joints")


def q(value):
    """Six joints that tell their order and the row."""
    return value + 0.01 * np.arange(6)


def imported(tmp_path, commanded, measured, *, form="ros1", **options):
    path = write_bag(tmp_path, form, {CHOICE.commanded: commanded, CHOICE.measured: measured})
    with open_bag(path) as bag:
        return read_recording(bag, CHOICE, **options)


@pytest.mark.parametrize("form", FORMS)
def test_each_measurement_has_the_last_command_before_it(tmp_path, form):
    sent = [joints(0.02 * k, q(0.01 * k)) for k in range(10)]
    seen = [joints(0.021 + 0.02 * k, q(0.01 * k + 0.1)) for k in range(9)]
    found = imported(tmp_path, sent, seen, form=form)
    recording = found.recording
    # the first command comes before any measurement; the tenth and last is at .18 s, the last measurement at .181 s
    assert_allclose(recording.q_cmd, [q(0.01 * k) for k in range(10)], atol=0)
    assert_array_equal(recording.valid, [False] + [True] * 9)
    assert_allclose(recording.q_phy[1:], [q(0.01 * k + 0.1) for k in range(9)], atol=0)
    assert_allclose(recording.t_s, [0.0, *(0.021 + 0.02 * np.arange(9))], atol=1e-9)
    assert (found.early, found.between, found.moving) == (0, 1, 0)
    assert load_recording(recording.save(tmp_path / "saved.npz")).q_cmd.tolist() == recording.q_cmd.tolist()


def test_commands_between_two_measurements_stay_as_rows_without_one(tmp_path):
    """A cable remembers them. Those that repeat the one before, or come after the last measurement, say nothing."""
    values = [0.1, 0.3, 0.2, 0.2, 0.4, 0.5, 0.6]
    sent = [joints(0.1 * k, q(value)) for k, value in enumerate(values)]
    seen = [joints(0.05, q(0.11)), joints(0.45, q(0.41))]
    found = imported(tmp_path, sent, seen)
    assert_allclose(found.recording.q_cmd[:, 0], [0.1, 0.3, 0.2, 0.4])
    assert_array_equal(found.recording.valid, [True, False, False, True])
    assert found.between == 2


def test_a_command_counts_from_its_stamp_on(tmp_path):
    found = imported(tmp_path, [joints(0.0, q(0.1)), joints(0.5, q(0.2))], [joints(0.4, q(0.0)), joints(0.5, q(0.0))])
    assert_allclose(found.recording.q_cmd[:, 0], [0.1, 0.2])


def test_measurements_before_the_first_command_are_left_out_and_counted(tmp_path):
    sent = [joints(1.0, q(0.1)), joints(2.0, q(0.2))]
    found = imported(tmp_path, sent, [joints(0.5 * k, q(0.0)) for k in range(5)])
    assert found.early == 2 and len(found.recording) == 3
    with pytest.raises(InvalidInput, match=r"comes 0.500 s after the last measurement of '/tracker/joints'"):
        imported(tmp_path / "..", sent, [joints(0.5, q(0.0))], form="sqlite")


def test_messages_that_are_not_valid_are_left_out_and_counted(tmp_path):
    sent = [
        joints(0.0, q(0.1)),
        joints(None, q(9.0)),
        joints(0.2, [], names=[]),
        joints(0.3, q(np.nan)),
        joints(0.4, q(0.2)),
    ]
    seen = [joints(0.1 * k, q(0.1)) for k in range(5)] + [joints(None, q(0.0))]
    found = imported(tmp_path, sent, seen)
    assert (found.commanded.unstamped, found.commanded.empty) == (1, 2)
    assert (found.measured.unstamped, found.measured.empty) == (1, 0)
    assert_allclose(found.recording.q_cmd[:, 0], [0.1, 0.1, 0.1, 0.1, 0.2])


def test_stamps_out_of_order_are_put_in_order_and_counted(tmp_path):
    sent = [joints(0.0, q(0.1)), joints(0.4, q(0.3)), joints(0.2, q(0.2))]
    found = imported(tmp_path, sent, [joints(0.1, q(0)), joints(0.3, q(0)), joints(0.5, q(0))])
    assert found.commanded.late == 1 and found.measured.late == 0
    assert_allclose(found.recording.q_cmd[:, 0], [0.1, 0.2, 0.3])


def test_only_measurements_at_rest_count_if_asked(tmp_path):
    """The command stands still from .2 s on; what repeats it is no motion."""
    sent = [joints(0.1 * k, q(0.1 * min(k, 2))) for k in range(8)]
    seen = [joints(0.1 * k, q(0.1 * min(k, 2))) for k in range(8)]
    found = imported(tmp_path, sent, seen, settled_s=0.3)
    assert_array_equal(found.recording.valid, [False] * 5 + [True] * 3)
    assert found.moving == 5


def test_a_slow_motion_is_no_standstill(tmp_path):
    """Steps of less than what counts as a motion add up: 5e-7 rad each ms is 0.5 mrad in a second."""
    sent = [joints(0.001 * k, q(5e-7 * min(k, 100))) for k in range(200)]
    found = imported(tmp_path, sent, [joints(0.001 * k, q(0.0)) for k in (50, 150, 199)], settled_s=0.05)
    assert found.moving == 1
    assert_array_equal(found.recording.valid[~np.isnan(found.recording.q_phy[:, 0])], [False, True, True])
    assert 40 < found.between < 60


def test_ends_of_motions_need_a_time_to_settle(tmp_path):
    topics = {"/PSM1/move_jp": [joints(0.0, q(0.0)), joints(1.0, q(0.5))]}
    topics["/tracker/joints"] = [joints(0.1 + 0.1 * k, q(0.0)) for k in range(30)]
    with open_bag(write_bag(tmp_path, "ros1", topics)) as bag:
        choice = choose(bag, "", *topics)
        with pytest.raises(InvalidInput, match=r"'/PSM1/move_jp' holds the ends of motions, .* give --settled"):
            read_recording(bag, choice)
        assert read_recording(bag, choice, settled_s=1.5).moving == 24


def test_messages_that_do_not_fit_are_left_out_and_counted(tmp_path):
    """Whatever else somebody publishes in the same topic does not end an import."""
    sent = [
        joints(0.0, q(0.1)),
        joints(0.1, q(0.2)[:5]),
        joints(0.2, q(0.2), names=PSM[:5]),
        joints(0.3, [0.5], names=["jaw"]),
        joints(0.4, np.zeros(7), names=[]),
        joints(0.5, q(0.3)),
    ]
    found = imported(tmp_path, sent, [joints(0.45, q(0.0)), joints(0.6, q(0.0))])
    assert (found.commanded.unfit, found.commanded.empty, found.measured.unfit) == (4, 0, 0)
    assert_allclose(found.recording.q_cmd[:, 0], [0.1, 0.3])


@pytest.mark.parametrize(
    ("names", "order"),
    [
        (PSM, ()),
        (tuple(f"outer_{name}" for name in PSM), ()),
        (tuple(f"PSM1_{name}" for name in PSM), ()),
        ((*PSM, "jaw"), ()),
        ((), ()),
        (("a", "b", "c", "d", "e", "f"), ("a", "b", "c", "d", "e", "f")),
    ],
)
def test_joints_are_ordered_by_their_names(tmp_path, names, order):
    mixed = np.random.default_rng(1).permutation(len(names)) if names else np.arange(6)
    values = np.append(q(0.1), 7.0)
    names_sent = [names[place] for place in mixed] if names else []
    sent = [joints(0.1 * k, values[mixed] + 0.1 * k, names=names_sent) for k in range(2)]
    seen = [joints(0.1 * k, q(0.1), names=names[:6] if names else []) for k in range(2)]
    found = imported(tmp_path, sent, seen, order=order)
    assert_allclose(found.recording.q_cmd, [q(0.1), q(0.2)])
    assert found.commanded.unnamed == (0 if names else 2)


@pytest.mark.parametrize(
    ("names", "count", "order", "said"),
    [
        (("yaw", "pitch", "insertion", "roll"), 4, (), r"has the joints yaw, pitch, insertion, roll, not once each of"),
        (("yaw", "outer_yaw", *PSM[1:]), 7, (), "not once each of"),
        ((), 4, (), "does not name its 4 joints"),
        ((), 6, ("a", "b", "c", "d", "e", "f"), "does not name its 6 joints"),
        (PSM, 7, (), "has a message of 6 names and 7 positions"),
        (PSM, 6, ("yaw", "pitch"), "does not name six joints"),
        (PSM, 6, ("yaw", *PSM[:5]), "does not name six joints"),
        (PSM, 6, (*PSM[:5], "wrist"), "joint of topic .* 'wrist' is unknown"),
    ],
)
def test_joints_that_are_not_a_psms_are_one_sentence(tmp_path, names, count, order, said):
    sent = [joints(0.1 * k, np.zeros(count), names=names) for k in range(2)]
    with pytest.raises(InvalidInput, match=said):
        imported(tmp_path, sent, sent, order=order)


def test_values_in_other_units_and_topics_without_valid_joints_are_refused(tmp_path):
    still = [joints(0.1 * k, q(0.0)) for k in range(2)]
    with pytest.raises(InvalidInput, match=r"commands of q1 up to 57.0, which looks like degrees"):
        imported(tmp_path, [joints(0.1 * k, q(57.0)) for k in range(2)], still)
    with pytest.raises(InvalidInput, match="holds no valid joints: 2 with a stamp of 0"):
        imported(tmp_path, [joints(None, q(0.0))] * 2, still, form="mcap")


TWO = {
    f"{arm}/{name}": [joints(0.0, q(0.0))]
    for arm, names in {
        "/PSM1": ("setpoint_js", "servo_jp", "measured_js", "jaw/setpoint_js", "jaw/measured_js"),
        "/PSM2": ("servo_jp", "measured_js"),
        "/ECM": ("measured_js",),
        "/tracker": ("measured_js",),
        "/console": ("move_jp",),
    }.items()
    for name in names
}


def chosen(tmp_path, topics, *words, **options):
    with open_bag(write_bag(tmp_path, "ros1", topics)) as bag:
        return choose(bag, *words, **options)


def test_the_arms_of_a_bag_are_found_by_the_names_of_crtk(tmp_path):
    with open_bag(write_bag(tmp_path, "ros1", TWO)) as bag:
        assert arms_in(bag) == ["/PSM1", "/PSM2"]
        assert choose(bag, "/PSM1") == choose(bag, "PSM1/") == Choice("/PSM1/setpoint_js", "/PSM1/measured_js", True)
        assert choose(bag, "/PSM2") == Choice("/PSM2/servo_jp", "/PSM2/measured_js", True)
        with pytest.raises(InvalidInput, match="holds the arms /PSM1, /PSM2; choose one, such as --namespace /PSM1"):
            choose(bag)
        with pytest.raises(InvalidInput, match="'/ECM/setpoint_js' is unknown"):
            choose(bag, "/ECM")
        tracked = choose(bag, "/PSM1", measured="/tracker/measured_js")
        assert tracked == Choice("/PSM1/setpoint_js", "/tracker/measured_js")
        assert not tracked.encoders
        assert choose(bag, "", "/console/move_jp", "/ECM/measured_js").commanded == "/console/move_jp"
        for words in (("", "/PSM1/measured_js", "/PSM1/measured_js"), ("/PSM1", "/PSM1/measured_js")):
            with pytest.raises(InvalidInput, match="'/PSM1/measured_js' cannot be commanded and measured at once"):
                choose(bag, *words)


def test_the_arm_of_a_topic_that_is_given_comes_first(tmp_path):
    with open_bag(write_bag(tmp_path, "ros1", TWO)) as bag:
        assert choose(bag, commanded="/PSM1/setpoint_js") == Choice("/PSM1/setpoint_js", "/PSM1/measured_js", True)
        assert choose(bag, measured="/PSM2/measured_js") == Choice("/PSM2/servo_jp", "/PSM2/measured_js", True)
        with pytest.raises(InvalidInput, match="holds the arms /PSM1, /PSM2, /console; choose one"):
            choose(bag, measured="/tracker/measured_js")


def test_commands_of_two_kinds_are_not_mixed_up(tmp_path):
    topics = {f"/PSM1/{name}": [joints(0.0, q(0.0))] for name in ("servo_jp", "move_jp", "measured_js")}
    with open_bag(write_bag(tmp_path, "ros1", topics)) as bag:
        with pytest.raises(
            InvalidInput, match="both in servo_jp and in move_jp; choose one, such as --commanded /PSM1/s"
        ):
            choose(bag)
        assert choose(bag, commanded="/PSM1/move_jp").commanded == "/PSM1/move_jp"
    topics["/PSM1/setpoint_js"] = [joints(0.0, q(0.0))]
    with open_bag(write_bag(tmp_path, "mcap", topics)) as bag:
        assert choose(bag).commanded == "/PSM1/setpoint_js"


@pytest.mark.parametrize(
    ("measured", "encoders"),
    [
        ("/PSM1/measured_js", True),
        ("/PSM1/other", True),
        ("/PSM1/true_js", False),
        ("/tracker/measured_js", False),
        ("/dvrk/PSM1/state_joint_current", True),
        ("/dvrk/PSM1/other", False),
    ],
)
def test_what_lies_beside_an_arms_commands_comes_from_its_encoders(tmp_path, measured, encoders):
    """Whatever its commands are: those of tips as well, and those in another namespace."""
    topics = {name: [joints(0.0, q(0.0))] for name in ("/console/servo_jp", "/PSM1/servo_cp", measured)}
    assert chosen(tmp_path, topics, "", "/console/servo_jp", measured).encoders == encoders


def test_topics_of_which_nothing_was_recorded_do_not_count(tmp_path):
    """A ROS 2 bag lists every topic that it subscribed to."""
    topics = {name: TWO[name] for name in ("/PSM1/servo_jp", "/PSM1/measured_js", "/PSM2/servo_jp")}
    with open_bag(write_bag(tmp_path, "sqlite", topics, silent=["/PSM1/setpoint_js", "/PSM2/measured_js"])) as bag:
        assert arms_in(bag) == ["/PSM1"] and choose(bag).commanded == "/PSM1/servo_jp"
        with pytest.raises(InvalidInput, match=r"'/PSM2/measured_js' .* has no message"):
            choose(bag, "/PSM2")


def test_the_only_arm_is_taken(tmp_path):
    one = {name: messages for name, messages in TWO.items() if name.startswith("/PSM1")}
    assert chosen(tmp_path, one) == Choice("/PSM1/setpoint_js", "/PSM1/measured_js", True)


def test_a_topic_that_is_given_need_not_be_in_the_arms_namespace(tmp_path):
    topics = {name: messages for name, messages in TWO.items() if name.split("/")[1] in ("ECM", "console")}
    topics["/console/other"] = [joints(0.0, q(0.0))]
    with open_bag(write_bag(tmp_path, "ros1", topics)) as bag:
        assert choose(bag, measured="/ECM/measured_js").commanded == "/console/move_jp"
        assert choose(bag, commanded="/console/other").measured == "/ECM/measured_js"
        with pytest.raises(InvalidInput, match=r"holds no arm .* joints are in: /ECM/measured_js, /console/move_jp"):
            choose(bag)
