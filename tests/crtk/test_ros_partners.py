"""The real rclpy and rospy read and command a served arm, on every topic and in both directions."""

from __future__ import annotations

import json
import subprocess
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from crtk_partners import DOMAIN, environment_of, python_of, ros1_master, said, served
from trocar.arms import fk
from trocar.crtk.convert import transform_of
from trocar.crtk.messages import (
    Bool,
    Empty,
    Float64,
    IntervalStatistics,
    OperatingState,
    Point,
    Pose,
    Quaternion,
    StringStamped,
    ros_name,
)
from trocar.crtk.reports import KINDS, body_jacobian, spatial_jacobian
from trocar.crtk.served_arm import EFFORTS, MOTIONS
from trocar.geometry import SE3
from trocar.lab import load_station

pytestmark = pytest.mark.realtime
PARTNER = Path(__file__).parent / "ros_partner.py"
OUT = KINDS | {"operating_state": OperatingState, "trajectory_j/ratio": Float64}
OUT |= {"period_statistics": IntervalStatistics}
IN = MOTIONS | EFFORTS | {"hold": Empty, "state_command": StringStamped}
IN |= {"trajectory_j/set_ratio": Float64, "emulate_tool_present": Bool}
ARM = load_station("peg-transfer").arms["psm1"]
NAMES = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"]


@pytest.mark.parametrize("ros", [1, 2])
def test_a_program_on_another_ros_reads_and_commands_every_topic_of_an_arm(ros):
    if not python_of(ros).exists():
        pytest.skip(f"tools/ros{ros}.sh makes .ros{ros}, with rospy or rclpy")
    with ros1_master() if ros == 1 else nullcontext("") as master:
        partner, cell = exchange(ros, master)
    check_reports(partner)
    check_commands(partner, cell)


def exchange(ros: int, master: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Let the partner read and command every topic; return what it and the cell say at the end."""
    words = ["--ros", str(ros), "--domain", str(DOMAIN)] + (["--master", master] if master else [])
    topics = {
        way: {topic: ros_name(kind) for topic, kind in kinds.items()} for way, kinds in (("out", OUT), ("in", IN))
    }
    with served(*words, **({"python": python_of(1)} if ros == 1 else {})) as cell:
        done = subprocess.run(
            [python_of(ros), PARTNER, str(ros), "/PSM1", json.dumps(topics)],
            env=environment_of(ros, DOMAIN, master),
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        return json.loads(done.stdout.splitlines()[-1]), said(cell)


def transform(heard: dict[str, Any], topic: str) -> SE3:
    """Return the pose that was heard."""
    pose = heard[topic]["pose"]
    return transform_of(Pose(Point(**pose["position"]), Quaternion(**pose["orientation"])))


def check_reports(partner: dict[str, Any]) -> None:
    """Check names, units, frames, stamps and values of all that the arm publishes."""
    assert set(partner["start"]["counts"]) == set(OUT)
    for step in partner.values():
        heard = step["heard"]
        q = np.array(heard["measured_js"]["position"])
        assert heard["measured_js"]["name"] == heard["setpoint_js"]["name"] == heard["goal_js"]["name"] == NAMES
        assert heard["jaw/measured_js"]["name"] == ["jaw"]
        assert len(heard["measured_js"]["velocity"]) == 6 and len(heard["measured_js"]["effort"]) == 0
        frames = {topic: heard[topic]["header"]["frame_id"] for topic in OUT if topic[-3:] in ("_cp", "_cv", "_cf")}
        assert {frame for topic, frame in frames.items() if "/" not in topic} == {"world"}
        assert (
            frames["local/measured_cp"] == frames["local/setpoint_cp"] == frames["spatial/measured_cf"] == "PSM1_base"
        )
        assert frames["body/measured_cf"] == "PSM1"
        for topic in ("body/measured_cf", "spatial/measured_cf"):  # CRTK: not available
            assert heard[topic]["header"]["stamp"] in (0, {"sec": 0, "nanosec": 0})
    heard = partner["start"]["heard"]  # at rest: whatever was heard last belongs together
    q = np.array(heard["measured_js"]["position"])
    assert np.abs(transform(heard, "local/measured_cp").matrix - fk(ARM.model, q).matrix).max() < 1e-9
    base = transform(heard, "measured_cp") @ transform(heard, "local/measured_cp").inverse()
    assert np.abs((base.inverse() @ ARM.T_world_base).translation_m).max() < 0.01
    for goal in ("setpoint_cp", "goal_cp"):
        setpoint = np.array(heard["setpoint_js"]["position"])
        assert np.abs(transform(heard, goal).matrix - (base @ fk(ARM.model, setpoint)).matrix).max() < 1e-9
    for topic, jacobian in (("body/jacobian", body_jacobian), ("spatial/jacobian", spatial_jacobian)):
        matrix = np.array(heard[topic]["data"]).reshape([one["size"] for one in heard[topic]["layout"]["dim"]])
        assert np.abs(matrix - jacobian(ARM.model, q)).max() < 1e-9
    periods = heard["period_statistics"]
    assert 1.0 <= periods["statistics_interval"] < 2.0 and 0.005 < periods["period_avg"] < 0.02
    assert periods["period_min"] <= periods["period_avg"] <= periods["period_max"]
    assert 0 < periods["compute_time_min"] <= periods["compute_time_avg"] <= periods["compute_time_max"]
    counted = periods["number_of_samples"] * periods["period_avg"]
    assert counted == pytest.approx(periods["statistics_interval"]) and periods["user_data"] == 0
    twist = heard["measured_cv"]["twist"]
    assert max(abs(value) for part in twist.values() for value in part.values()) < 1e-6


def check_commands(partner: dict[str, Any], cell: dict[str, Any]) -> None:
    """Check that all that was commanded has come and was done, or refused with a reason."""
    counts = cell["commands"]["psm1"]
    assert set(counts) == set(IN) and counts["servo_jp"] == partner["servo_jp"]["sent"]
    for step in ("servo_jp", "move_jp", "move_jr"):
        assert partner[step]["heard"]["setpoint_js"]["position"] == pytest.approx(partner[step]["commanded"], abs=1e-9)
        assert partner[step]["heard"]["goal_js"]["position"] == pytest.approx(partner[step]["commanded"], abs=1e-9)
    assert partner["jaw"]["heard"]["jaw/setpoint_js"]["position"] == pytest.approx(partner["jaw"]["commanded"])
    refused = {event["topic"] for event in cell["events"] if event["name"] == "refused"}
    assert refused == set(EFFORTS)
    assert cell["received"] == {"psm1": counts["servo_jp"] + counts["servo_jr"] + counts["servo_cp"], "psm2": 0}
    assert max(cell["limit_use"]["psm1"]) <= 1.001
