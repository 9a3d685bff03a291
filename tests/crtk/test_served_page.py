"""Whoever opens the page of a served cell sees it live: its arms, who commands them, what was refused."""

import re
import signal

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")
pytest.importorskip("viser", reason="the extra 'view' is not installed")
from live_scene import messages

from crtk_partners import DOMAIN, trocar, until
from trocar.crtk.bus import open_bus, stamped
from trocar.crtk.messages import JointState, StringStamped
from trocar.lab.topics import Topics
from trocar.tasks.peg_transfer.report import PegReport

pytestmark = pytest.mark.realtime


@pytest.fixture
def served(tmp_path):
    words = ("--task", "peg-transfer", "--option", "variant=bilateral", "--out", tmp_path)
    process = trocar("crtk", "serve", "peg-transfer", "--seed", 3, "--view", *words)
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
    until(lambda: asked.readers() and paused.readers())
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
