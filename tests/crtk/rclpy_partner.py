"""Run by the python of .ros2: reads an arm with the real rclpy, streams set-points to it, prints what it did."""

import json
import math
import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState

rclpy.init()
node = rclpy.create_node("partner")
measured, poses = [], []
node.create_subscription(JointState, "/PSM1/measured_js", measured.append, 10)
node.create_subscription(PoseStamped, "/PSM1/measured_cp", poses.append, 10)
servo = node.create_publisher(JointState, "/PSM1/servo_jp", 10)


def spin(seconds):
    """Take what comes for some time."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        rclpy.spin_once(node, timeout_sec=max(0.0, end_s - time.monotonic()))


deadline_s = time.monotonic() + 30.0
while not (measured and poses and servo.get_subscription_count()):
    if time.monotonic() > deadline_s:
        sys.exit("nothing was heard of /PSM1")
    spin(0.1)
start, sent, q = list(measured[-1].position), 0, None
for k in range(200):
    q = [value + 0.02 * math.sin(k / 30) * (0.1 if joint == 2 else 1.0) for joint, value in enumerate(start)]
    servo.publish(JointState(name=list(measured[-1].name), position=q))
    sent += 1
    spin(0.01)
spin(0.5)
place = poses[-1].pose.position
answer = {"measured": len(measured), "names": list(measured[-1].name), "last_pose": [place.x, place.y, place.z]}
print(json.dumps({**answer, "sent": sent, "commanded": q}))
