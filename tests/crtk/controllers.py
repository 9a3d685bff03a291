"""Controllers of other dialects, as test partners in processes of their own; they know nothing of our dialects.

Arguments: ``raven`` or ``crtk-1.0``, ROS, domain, master, and the joints at which the arm is when it starts.

``raven``: as uw-biorobotics/raven2 (branch crtk) does it. Seven joints, the last two those of the jaws; an increment is
cut off at .0025 rad or .05 mm; ``setpoint_js`` repeats the last increment; nobody publishes ``/grasp1/setpoint_js``.
What is off: each increment is cut off by itself, where a Raven adds up those of one millisecond and cuts off the sum.
``crtk-1.0``: a PSM with the messages that CRTK 1.1 renamed. It goes wherever it is sent at once.
Both say ``ready`` when they publish, take ``STATE 1`` (homed) or ``STATE 0`` on stdin as what they are from then on,
and say at their end, on SIGTERM, their joints, how many commands they took and how many increments they cut off.
"""

import json
import signal
import sys
import threading
import time

from trocar.crtk.bus import open_bus, stamped
from trocar.crtk.messages import JointState, OldOperatingState, TransformStamped
from trocar.lab.topics import Topics

DIALECT, ROS, DOMAIN, MASTER, START = sys.argv[1:6]
PERIOD_S = 0.001
PUBLISHED_EVERY = 10
LIMITS = (0.0025, 0.0025, 0.00005, 0.0025, 0.0025, 0.0025, 0.0025)


class Raven:
    """The left arm of a Raven II."""

    space, jaw, colour = "/arm1", "/grasp1", "gold"
    hears = (("/arm1/servo_jr", "move"),)
    joints = ("shoulder", "elbow", "ins", "roll", "wrist", "jaw1", "jaw2")

    def __init__(self, q):
        self.q, self.last, self.cut = list(q), [0.0] * 7, 0

    def move(self, increments):
        self.last = list(increments)
        for i, (step, limit) in enumerate(zip(increments, LIMITS, strict=True)):
            self.cut += abs(step) > limit * (1 + 1e-9)
            self.q[i] += min(max(step, -limit), limit)

    def says(self):
        names = [f"{self.colour}_{name}" for name in self.joints]
        opening = [self.q[5] + self.q[6], self.q[5], self.q[6]]
        jaws = [f"{self.colour}_{name}" for name in ("grasp", "jaw1", "jaw2")]
        yield "/arm1/measured_js", JointState(stamped(), names, self.q)
        yield "/arm1/setpoint_js", JointState(stamped(), names, self.last)
        yield "/grasp1/measured_js", JointState(stamped(), jaws, opening)


class OldPsm:
    """A PSM before CRTK 1.1."""

    space = "/PSM1"
    hears = (("/PSM1/servo_jp", "move"), ("/PSM1/jaw/servo_jp", "open"))
    joints = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")

    def __init__(self, q):
        self.q, self.cut = list(q), 0

    def move(self, q):
        self.q[:6] = q

    def open(self, jaw):
        self.q[6] = jaw[0]

    def says(self):
        for what in ("measured_js", "setpoint_js"):
            yield f"/PSM1/{what}", JointState(stamped(), list(self.joints), self.q[:6])
            yield f"/PSM1/jaw/{what}", JointState(stamped(), ["jaw"], self.q[6:])
        yield "/PSM1/measured_cp", TransformStamped(stamped())


ended, states = [], [("ENABLED", True)]


def listen():
    for line in sys.stdin:
        word, homed = line.split()
        states.append((word, homed == "1"))


threading.Thread(target=listen, daemon=True).start()
signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
arm = {"raven": Raven, "crtk-1.0": OldPsm}[DIALECT](json.loads(START))
bus = open_bus(Topics(ros=int(ROS), domain=int(DOMAIN), master=MASTER))
state = bus.publisher(f"{arm.space}/operating_state", OldOperatingState, latched=True)
publishers = {topic: bus.publisher(topic, type(message)) for topic, message in arm.says()}
commands = [(bus.subscriber(topic, JointState), getattr(arm, does)) for topic, does in arm.hears]
print("ready", flush=True)
cycle, taken, due_s = 0, 0, time.monotonic()
while not ended:
    for source, does in commands:
        for message in source.take():
            does(message.position)
            taken += 1
    if cycle % PUBLISHED_EVERY == 0:
        state.send(OldOperatingState(stamped(), *states[-1], False))
        for topic, message in arm.says():
            publishers[topic].send(message)
    cycle, due_s = cycle + 1, max(due_s + PERIOD_S, time.monotonic())
    time.sleep(max(0.0, due_s - time.monotonic()))
print(json.dumps({"q": arm.q, "taken": taken, "cut": arm.cut}))
