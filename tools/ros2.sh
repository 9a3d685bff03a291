#!/usr/bin/env bash
# Makes .ros2: Python 3.12 with the real rclpy (ROS 2 Kilted, Fast DDS), a test partner for trocar.crtk. 290 MB.
set -euo pipefail
cd "$(dirname "$0")/.."
python3.12 -m venv .ros2
.ros2/bin/pip install --quiet ros-kilted-rclpy==9.1.2 ros-kilted-rmw-fastrtps-cpp==9.3.3 ros-kilted-sensor-msgs==5.5.1 \
  ros-kilted-geometry-msgs==5.5.1 ros-kilted-std-msgs
.ros2/bin/python -c "import rclpy, sensor_msgs.msg; print('rclpy is ready in .ros2')"
