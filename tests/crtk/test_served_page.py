"""Whoever opens the page of a served cell sees it live: its arms, who commands them, what was refused."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")
pytest.importorskip("viser", reason="the extra 'view' is not installed")
from live_scene import messages

from trocar.crtk.bus import open_bus, stamped
from trocar.crtk.messages import JointState, StringStamped
from trocar.lab.topics import Topics
from trocar.tasks.peg_transfer.report import PegReport

pytestmark = pytest.mark.realtime
DOMAIN = 40 + os.getpid() % 150


@pytest.fixture
def served(tmp_path):
    words = [sys.executable, "-m", "trocar", "crtk", "serve", "peg-transfer", "--seed", "3", "--view"]
    words += ["--task", "peg-transfer", "--option", "variant=bilateral", "--out", str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "ROS_DOMAIN_ID": str(DOMAIN)}
    process = subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    yield process
    process.kill()
    process.wait()


def test_the_page_tells_the_state_of_an_arm_who_commands_it_and_what_was_refused(served):
    found = None
    for line in served.stdout:
        found = found or re.search(r"http://127.0.0.1:(\d+)", line)
        if line.startswith("serving"):
            break
    bus = open_bus(Topics(domain=DOMAIN))
    asked = bus.publisher("/PSM1/servo_jf", JointState)
    paused = bus.publisher("/PSM1/state_command", StringStamped)
    end_s = time.monotonic() + 30.0
    while not (asked.readers() and paused.readers()):
        assert time.monotonic() < end_s
        time.sleep(0.02)
    asked.send(JointState(stamped()))
    paused.send(StringStamped(stamped(), "pause"))
    wanted, moved = {"PAUSED", "ENABLED", "servo_jf: the simulated arm is driven by positions alone", "/PSM2"}, set()
    colours = {}
    for message in messages(int(found[1])):
        if message["type"] == "SetPositionMessage":
            moved.add(message["name"])
        if message["type"] == "MeshMessage":
            colours[message["name"]] = message["props"]["color"]
        told = str(message.get("updates", {}).get("content", ""))
        if "/PSM1" in told and all(text in told for text in wanted):
            break
    served.send_signal(signal.SIGTERM)
    assert "served for" in served.communicate(timeout=60)[0] and served.returncode == 0
    assert {"/bodies/psm1_link6", "/bodies/psm2_finger_left"} <= moved
    amber = [round(255 * share) for share in PegReport.colours["block"]]
    assert [list(colour) for name, colour in colours.items() if "block" in name] == 6 * [amber], "as in replays"
