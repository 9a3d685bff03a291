"""Move an arm of a console with a phone, through the package teleop (WebXR), in a virtual environment of its own.

pip install teleop
trocar run peg-transfer --method person --watch --devices 7000
python examples/teleop_phone.py --console 7000 --arm psm1

Open the printed address on a phone in the same network, face the way the camera looks, and start WebXR. The arm
follows while *hold to move* is pressed; *gripper* opens and closes the jaws. If the camera looks along -y of the world,
as in the debridement, give --facing -90.
"""

import argparse
import json
import math
import os
import socket
import time

import transforms3d as t3d
from teleop import Teleop

OPEN = 0.4  # share of the jaws' range
SCALE = 0.3  # metres of the tip per metre of the phone; below 1, teleop's own slider scales rotations too
EVERY_S = 1.0  # between two printed messages of the console


class Phone:
    """Passes the phone's messages to the console, one line for each.

    Args:
        port: port of the console's devices.
        arm: name of the arm.
        facing_deg: where the phone's holder looks: angle from the world's x axis, about its z axis.
    """

    def __init__(self, port, arm, facing_deg):
        self.arm, self.turn = arm, t3d.euler.euler2mat(0, 0, math.radians(facing_deg))
        self.stream = socket.create_connection(("127.0.0.1", port)).makefile("rwb")
        self.said, self.said_s = "", -math.inf

    def __call__(self, pose, message):
        """Send the phone's pose (4 x 4, axes forward, left, up); only changes while *hold to move* is pressed count."""
        line = {"arm": self.arm, "held": message["move"], "jaw": 0 if message["gripper"] == "close" else OPEN}
        if line["held"]:
            w, x, y, z = t3d.quaternions.mat2quat(self.turn @ pose[:3, :3] @ self.turn.T)
            position = (self.turn @ pose[:3, 3]).tolist()
            line |= {"position": position, "quaternion": [x, y, z, w], "scale": SCALE}
        try:
            self.stream.write(json.dumps(line).encode() + b"\n")
            self.stream.flush()
            answer = self.stream.readline()
        except OSError:
            answer = b""
        if not answer:
            print("the console has ended", flush=True)
            os._exit(0)  # the server would catch an exception and go on
        self.tell(json.loads(answer))

    def tell(self, answer):
        """Print what the console says, if it is new, and not too often."""
        said, now_s = answer.get("error", answer.get("words", "")), time.monotonic()
        if said != self.said and now_s - self.said_s > EVERY_S:
            self.said, self.said_s = said, now_s
            print(said, flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--console", type=int, default=7000, help="Port of the console's devices.")
    parser.add_argument("--arm", default="psm1")
    parser.add_argument("--facing", type=float, default=90, help="Degrees from the world's x axis to where one looks.")
    parser.add_argument("--port", type=int, default=4443, help="Port on which the telephone comes.")
    given = parser.parse_args()
    server = Teleop(port=given.port)
    server.subscribe(Phone(given.console, given.arm, given.facing))
    server.run()
