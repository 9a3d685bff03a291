"""Loaded by a public client's Python at its start: writes down what it publishes, into the file CRTK_SENT."""

import atexit
import json
import os

SENT = []


def recorded(publish, topic_of):
    """Return a publisher's method that also writes down joints and poses."""

    def published(self, message, *others):
        if hasattr(message, "header"):
            stamp = message.header.stamp
            stamp_s = stamp.to_sec() if hasattr(stamp, "to_sec") else stamp.sec + 1e-9 * stamp.nanosec
            pose = getattr(message, "pose", None)
            if pose is not None:
                p, q = pose.position, pose.orientation
                SENT.append([topic_of(self), stamp_s, [p.x, p.y, p.z, q.x, q.y, q.z, q.w]])
            elif hasattr(message, "position"):
                SENT.append([topic_of(self), stamp_s, list(message.position)])
        return publish(self, message, *others)

    return published


def write():
    """Write the file."""
    with open(os.environ["CRTK_SENT"], "w") as file:
        json.dump(SENT, file)


if os.environ.get("CRTK_SENT"):
    atexit.register(write)
    if os.environ["ROS_VERSION"] == "2":
        from rclpy.publisher import Publisher

        Publisher.publish = recorded(Publisher.publish, lambda publisher: publisher.topic_name)
    else:
        from rospy import Publisher

        Publisher.publish = recorded(Publisher.publish, lambda publisher: publisher.name)
