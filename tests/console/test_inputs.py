"""Devices that move arms over a socket."""

import json
import socket
import time

import numpy as np
import pytest

from trocar.console.inputs import Inputs, wishes_of
from trocar.errors import InvalidInput
from trocar.view.wishes import Wish

ARMS = {"psm1": {"position": [0.0, 0.0, 0.1]}}
HOLD = {"arm": "psm1", "held": True, "position": [0.1, 0.2, 0.3], "quaternion": [0, 0, 1, 0], "scale": 0.5, "jaw": 0.4}


def line(**values):
    return json.dumps(values).encode()


def test_a_line_says_where_a_device_is():
    hold, jaw = wishes_of(line(**HOLD), "pad", ARMS)
    assert (hold.wish, hold.arm, hold.source) == (Wish.HOLD, "psm1", "pad")
    np.testing.assert_allclose(hold.value.position_m, HOLD["position"])
    np.testing.assert_allclose(hold.value.wxyz, [0, 0, 0, 1])  # w first
    assert hold.value.turns and hold.value.scale == 0.5
    assert (jaw.wish, jaw.value) == (Wish.JAW, 0.4)


def test_a_device_without_orientation_locks_it():
    (hold,) = wishes_of(line(arm="psm1", held=True, position=[0, 0, 0]), "pad", ARMS)
    assert not hold.value.turns and hold.value.scale == 1.0


def test_a_line_lets_go_and_asks_by_name():
    (release,) = wishes_of(line(arm="psm1", held=False), "pad", ARMS)
    assert release.wish is Wish.RELEASE
    (stop,) = wishes_of(line(wish="emergency"), "pad", ARMS)
    assert stop.wish is Wish.EMERGENCY


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (b"held", "no JSON"),
        (b"[1]", "no JSON object"),
        (line(arm="psm9", held=True, position=[0, 0, 0]), "psm1"),
        (line(arm="psm1", held=True), "position is None"),
        (line(arm="psm1", held=True, position=[0, 0]), "3 numbers of at most"),
        (b'{"arm": "psm1", "held": true, "position": [0, 0, NaN]}', "3 numbers of at most"),
        (line(arm="psm1", held=True, position=[0, 0, 0], quaternion=[0, 0, 0, 0]), "all 0"),
        (line(arm="psm1", jaw="open"), "1 number of at most"),
        (line(wish="explode"), "take, return, stop"),
        (line(wish="take"), "names no arm"),
        (line(held=True, position=[0, 0, 0]), "names no arm"),
        (line(jaw=0.5), "names no arm"),
        (line(**{**HOLD, "scale": -1}), "above 0"),
        (line(**{**HOLD, "scale": 1e5}), "up to 10"),
        (line(**{**HOLD, "position": [1e300, 0, 0]}), "3 numbers of at most 1e"),
        (line(arm="psm1", jaw=10**400), "1 number of at most"),
        (line(wish=[]), "take, return, stop"),
        (line(arm=["psm1"], jaw=1), "arm is"),
        (b"[" * 100_000, "no JSON"),
    ],
)
def test_a_wrong_line_is_told_in_a_sentence(sent, said):
    with pytest.raises(InvalidInput, match=said):
        wishes_of(sent, "pad", ARMS)


def test_a_line_before_the_trial_is_told_to_wait():
    with pytest.raises(InvalidInput, match="wait until the trial has begun"):
        wishes_of(line(**HOLD), "pad", {})


def until(found, wait_s=5.0):
    end = time.monotonic() + wait_s
    while time.monotonic() < end:
        if result := found():
            return result
        time.sleep(0.01)
    raise TimeoutError


def test_each_line_is_answered_and_a_device_that_leaves_lets_go():
    with Inputs(0, lambda: {"time_s": 1.5, "arms": ARMS, "words": "Runs"}) as inputs:
        address = "127.0.0.1", inputs.port
        with socket.create_connection(address) as connection, connection.makefile("rwb") as stream:
            for sent in (line(**HOLD), b"nonsense"):
                stream.write(sent + b"\n")
            stream.flush()
            assert json.loads(stream.readline())["arms"] == ARMS
            assert "no JSON" in json.loads(stream.readline())["error"]
            assert [said.wish for said in until(inputs.said)] == [Wish.HOLD, Wish.JAW]
        (left,) = until(inputs.said)
        assert (left.wish, left.arm) == (Wish.RELEASE, "psm1")


def test_a_web_page_cannot_send_lines():
    """A browser lets any website send text to any port of this machine."""
    post = b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: https://example.com\r\n\r\n" + line(wish="go_on") + b"\n"
    with Inputs(0, lambda: {"arms": ARMS}) as inputs:
        with socket.create_connection(("127.0.0.1", inputs.port), timeout=5) as connection:
            connection.sendall(post)
            assert connection.recv(100) == b"", "it hangs up"
        assert not inputs.said()


def test_a_port_that_is_taken_is_told_in_a_sentence():
    with (
        Inputs(0, lambda: {"arms": {}}) as inputs,
        pytest.raises(InvalidInput, match=f"--devices is {inputs.port}; .*in use; give another port"),
    ):
        Inputs(inputs.port, lambda: {"arms": {}})
