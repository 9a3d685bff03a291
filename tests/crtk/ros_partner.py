"""A program on the real rclpy or rospy, run by the Python of .ros2 or .ros1: reads and writes every topic of an arm.

Its arguments: 1 or 2; the arm's namespace; JSON of its topics, "out" of the arm and "in", each with its type. It prints
what it has heard last on each topic after each of its steps.
"""

import importlib
import json
import math
import sys
import threading
import time

ROS, SPACE, TOPICS = int(sys.argv[1]), sys.argv[2], json.loads(sys.argv[3])
LIMIT_S = 60.0


def kind(name):
    """Return the class of a type such as sensor_msgs/JointState."""
    package, _, message = name.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), message)


def plain(value):
    """Return a message as dictionaries, lists and numbers."""
    if hasattr(value, "to_nsec"):  # rospy's times
        return value.to_nsec()
    names = getattr(value, "__slots__", None)
    if names and not isinstance(value, str):
        return {name.lstrip("_").lower(): plain(getattr(value, name)) for name in names if name != "_check_fields"}
    if isinstance(value, (str, bytes, bool, int, float)):
        return value
    return [plain(one) for one in value]


heard, counts = {}, dict.fromkeys(TOPICS["out"], 0)


def listen(topic):
    def hear(message):
        heard[topic], counts[topic] = message, counts[topic] + 1

    return hear


if ROS == 2:
    import rclpy

    rclpy.init()
    node = rclpy.create_node("partner")
    keep = [node.create_subscription(kind(k), f"{SPACE}/{t}", listen(t), 10) for t, k in TOPICS["out"].items()]
    writers = {t: node.create_publisher(kind(k), f"{SPACE}/{t}", 100) for t, k in TOPICS["in"].items()}
    spinning = threading.Thread(target=rclpy.spin, args=(node,))
    spinning.start()
else:
    import rospy

    rospy.init_node("partner", anonymous=True, disable_signals=True)
    keep = [rospy.Subscriber(f"{SPACE}/{t}", kind(k), listen(t)) for t, k in TOPICS["out"].items()]
    writers = {t: rospy.Publisher(f"{SPACE}/{t}", kind(k), queue_size=100) for t, k in TOPICS["in"].items()}


def readers(topic):
    return writers[topic].get_subscription_count() if ROS == 2 else writers[topic].get_num_connections()


def leave():
    """End what would keep the program from ending."""
    if ROS == 2:
        rclpy.shutdown()
        spinning.join()


def until(what, holds):
    """Wait for a condition; end the program with what it was if it does not come."""
    end_s = time.monotonic() + LIMIT_S
    while not holds():
        if time.monotonic() > end_s:
            leave()
            sys.exit(f"it does not come to that: {what}; heard {counts}")
        time.sleep(0.002)


def send(topic, **values):
    """Publish a message with these values."""
    message = kind(TOPICS["in"][topic])()
    for path, value in values.items():
        target = message
        *parts, last = path.split("__")
        for part in parts:
            target = getattr(target, part)
        setattr(target, last, value)
    writers[topic].publish(message)


def moved(topic, **values):
    """Command a motion and wait until the arm has been busy and is not any more."""
    before = counts["operating_state"]
    send(topic, **values)
    until(f"{topic} is over", lambda: counts["operating_state"] >= before + 2 and not heard["operating_state"].is_busy)


def at(topic, goal):
    return lambda: max(abs(a - b) for a, b in zip(heard[topic].position, goal, strict=True)) < 1e-9


def is_at(place):
    here = heard["setpoint_cp"].pose.position
    return max(abs(here.x - place[0]), abs(here.y - place[1]), abs(here.z - place[2])) < 1e-9


def pose_values(message, dx):
    p, q = message.pose.position, message.pose.orientation
    names = {f"pose__orientation__{axis}": getattr(q, axis) for axis in "xyzw"}
    return {**names, "pose__position__x": p.x + dx, "pose__position__y": p.y, "pose__position__z": p.z}


answer = {}


def note(step, **said):
    answer[step] = {**said, "heard": {topic: plain(message) for topic, message in heard.items()}}


until("every topic is heard", lambda: all(counts.values()))
until("every topic is read", lambda: all(readers(topic) for topic in writers))
note("start", counts=dict(counts))

send("state_command", string="pause")
until("it is paused", lambda: heard["operating_state"].state == "PAUSED")
send("state_command", string="resume")
until("it is resumed", lambda: heard["operating_state"].state == "ENABLED")

names, start = list(heard["setpoint_js"].name), list(heard["setpoint_js"].position)
for k in range(100):
    q = [value + 0.02 * math.sin(k / 30) * (0.1 if joint == 2 else 1.0) for joint, value in enumerate(start)]
    send("servo_jp", name=names, position=q)
    time.sleep(0.01)
until("the stream is played back", at("setpoint_js", q))
note("servo_jp", commanded=list(q), sent=100)

send("servo_jr", position=[0.01] + 5 * [0.0])
q[0] += 0.01
until("the increment is made", at("setpoint_js", q))
send("trajectory_j/set_ratio", data=0.5)
until("the ratio is told", lambda: heard["trajectory_j/ratio"].data == 0.5)
q = [value + 0.05 for value in start[:2]] + start[2:]
moved("move_jp", position=q)
until("it is there", at("setpoint_js", q))
note("move_jp", commanded=list(q))
moved("move_jr", position=[-0.05] + 5 * [0.0])
q[0] -= 0.05
until("it has moved by that", at("setpoint_js", q))
note("move_jr", commanded=list(q))

here = heard["setpoint_cp"]
moved("move_cp", **pose_values(here, 0.01))
place = [here.pose.position.x + 0.01, here.pose.position.y, here.pose.position.z]
until("it is there", lambda: is_at(place))
note("move_cp", commanded=place)
send("servo_cp", **pose_values(heard["setpoint_cp"], 0.0005))
place[0] += 0.0005
until("it is there", lambda: is_at(place))

moved("jaw/move_jp", position=[0.6])
until("the jaws are open", at("jaw/setpoint_js", [0.6]))
send("jaw/servo_jp", position=[0.58])
until("the jaws are there", at("jaw/setpoint_js", [0.58]))
note("jaw", commanded=[0.58])

for topic, values in {
    "servo_jf": {"effort": 6 * [0.1]},
    "jaw/servo_jf": {"effort": [0.1]},
    "body/servo_cf": {"wrench__force__x": 1.0},
    "spatial/servo_cf": {"wrench__force__x": 1.0},
    "use_gravity_compensation": {"data": True},
    "body/set_cf_orientation_absolute": {"data": True},
    "emulate_tool_present": {"data": True},
    "free": {},
}.items():
    send(topic, **values)
before = counts["operating_state"]
send("move_jp", position=[value + 0.4 for value in start[:1]] + start[1:])
until("it goes", lambda: heard["setpoint_js"].position[0] > start[0] + 0.05)
send("hold")
until("it is at rest", lambda: counts["operating_state"] >= before + 2 and not heard["operating_state"].is_busy)
note("hold")
print(json.dumps(answer))
leave()
