"""Arms of every dialect, each driven over the network by another process than that of its controller."""

import json
import subprocess
import sys
import time
from contextlib import contextmanager, nullcontext
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from crtk_partners import ANYBODYS, DOMAIN, controlled, python_of, ros1_master, said, served
from trocar.crtk.bus import open_bus
from trocar.crtk.doctor import Verdict, examine_arm
from trocar.crtk.listening import Listener, listen
from trocar.lab import load_station
from trocar.lab.topics import Dialect, Topics

pytestmark = pytest.mark.realtime
ALONE = DOMAIN + 1
"""Nobody else was there: one that was killed counts as there for ten seconds more."""
ros1 = pytest.mark.skipif(not python_of(1).exists(), reason="no rospy: tools/ros1.sh makes .ros1")
EACH_ROS = pytest.mark.parametrize("ros", [pytest.param(1, marks=ros1), 2])


RAVEN_ARMS = {"left": "/arm1"}


def raven_start():
    """Return a Raven's seven joints where it parks: yaw = (jaw2 - jaw1) / 2, as in r2_kinematics.cpp."""
    q, grasp = load_station("raven-pair").arms["left"].park_q(), 0.3
    return [*q[:5], grasp / 2 - q[5], grasp / 2 + q[5]]


def python(ros):
    return python_of(1) if ros == 1 else Path(sys.executable)


@contextmanager
def network(ros):
    """Yield what Topics takes of it."""
    with ros1_master() if ros == 1 else nullcontext("http://127.0.0.1:11311") as master:
        yield {"ros": ros, "domain": DOMAIN, "master": master}


def driven(station, arm, topics):
    """Drive an arm in a process of its own; return joints and opening to which it was sent."""
    words = [python(topics["ros"]), Path(__file__).parent / "drive.py", station, arm, json.dumps(topics)]
    done = subprocess.run(words, env=ANYBODYS, capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return np.array(json.loads(done.stdout.splitlines()[-1]))


def with_controller(station, arm, topics, start):
    """Drive an arm of a controller; return where it was sent, and what the controller says at its end."""
    where = {name: topics[name] for name in ("ros", "domain", "master")}
    with controlled(topics["dialect"], start, **where) as controller:
        sent = driven(station, arm, topics)
        controller.terminate()
        return sent, json.loads(controller.communicate(timeout=30)[0])


@EACH_ROS
def test_a_raven_is_moved_by_increments_that_it_does_not_cut_off_and_ends_where_it_was_sent(ros):
    with network(ros) as where:
        topics = where | {"dialect": "raven", "command": "servo_jp", "arms": RAVEN_ARMS}
        sent, end = with_controller("raven-pair", "left", topics, raven_start())
    *arrived, jaw1, jaw2 = end["q"]
    assert np.abs(np.array([*arrived, (jaw2 - jaw1) / 2, jaw1 + jaw2]) - sent).max() < 1e-6
    assert end["cut"] == 0


@EACH_ROS
def test_an_arm_of_before_crtk_1_1_ends_where_it_was_sent(ros):
    park = load_station("peg-transfer").arms["psm1"].park_q()
    with network(ros) as where:
        topics = where | {"dialect": "crtk-1.0", "command": "servo_jp"}
        sent, end = with_controller("peg-transfer", "psm1", topics, [*park, 0.3])
    assert np.abs(np.array(end["q"]) - sent).max() < 1e-6


@EACH_ROS
def test_an_arm_that_is_sent_goals_ends_where_it_was_sent(ros):
    with network(ros) as where:
        words = ["--ros", str(ros), "--domain", str(DOMAIN), "--master", where["master"]]
        with served(*words, python=python(ros)) as cell:
            driven("peg-transfer", "psm1", where | {"dialect": "dvrk", "command": "move_jp"})
            end = said(cell)
    assert end["commands"]["psm1"]["move_jp"] > 100 and max(end["limit_use"]["psm1"]) <= 1.001


def test_the_doctor_finds_nothing_wrong_with_a_raven_but_what_a_busy_machine_does_to_it():
    station, topics = load_station("raven-pair"), Topics(domain=ALONE, dialect=Dialect.RAVEN, arms=RAVEN_ARMS)
    with network(2) as where, controlled("raven", raven_start(), **where | {"domain": ALONE}):
        listener = Listener(open_bus(topics), station, topics, ["left"])
        end_s = time.monotonic() + 30.0
        while len(listener.heard().messages["/arm1/measured_js"]) < 50:
            assert time.monotonic() < end_s, "it is not heard"
            listen(listener, 0.5)
        checks = {check.name: check for check in examine_arm(listener.heard(), station, topics, "left")}
    assert {name for name, check in checks.items() if check.verdict is Verdict.FAIL} <= {
        "rate",
        "gaps",
        "latency",
        "jitter",
    }
    passed = {name for name, check in checks.items() if check.verdict is Verdict.PASS}
    assert {"topics", "types", "commands", "data", "stamps", "state", "names", "speeds"} <= passed
