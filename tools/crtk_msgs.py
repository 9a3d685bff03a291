"""Writes the ROS package ``crtk_msgs``, as far as CRTK's clients in Python import it, into the folder that is given.

No package index has it. ``tools/ros1.sh`` and ``tools/ros2.sh`` make Python of it for their test partners.
"""

import sys
from pathlib import Path

GAINS = "crtk_msgs/CartesianImpedanceHalfPlaneGains"
INTERFACES = {
    "msg/StringStamped": "std_msgs/Header header, string string",
    "msg/OperatingState": "std_msgs/Header header, string state, bool is_homed, bool is_busy",
    "msg/CartesianImpedanceHalfPlaneGains": ", ".join(
        f"geometry_msgs/Vector3 {name}" for name in ("p", "d", "bias", "deadband")
    ),
    "msg/CartesianImpedance": "std_msgs/Header header, geometry_msgs/Quaternion force_orientation, "
    "geometry_msgs/Vector3 force_position, geometry_msgs/Quaternion torque_orientation, "
    + ", ".join(f"{GAINS} {what}_{sign}" for what in ("position", "orientation") for sign in ("positive", "negative")),
    "srv/QueryForwardKinematics": "float64[] jp, geometry_msgs/Pose cp, ---, "
    "geometry_msgs/Pose cp, bool result, string message",
    "srv/QueryInverseKinematics": "geometry_msgs/Pose cp, float64[] jp, ---, float64[] jp, bool result, string message",
}
"""Fields of each message and service of crtk_msgs 1.3."""
CMAKE = """cmake_minimum_required(VERSION 3.16)
project(crtk_msgs)
find_package(ament_cmake REQUIRED)
foreach(step rosidl_cmake rosidl_generator_type_description rosidl_generator_c rosidl_typesupport_introspection_c
    rosidl_typesupport_fastrtps_c rosidl_typesupport_c rosidl_generator_py)
  find_package(${step} REQUIRED)
endforeach()
find_package(std_msgs REQUIRED)
find_package(geometry_msgs REQUIRED)
rosidl_generate_interfaces(crtk_msgs FILES DEPENDENCIES std_msgs geometry_msgs)
ament_package()
"""
PACKAGE = """<package format="3"><name>crtk_msgs</name><version>1.3.0</version><description>of CRTK</description>
<maintainer email="nobody@example.org">nobody</maintainer><license>MIT</license>
<member_of_group>rosidl_interface_packages</member_of_group></package>
"""


def main() -> None:
    """Write the package."""
    folder, files = Path(sys.argv[1]), []
    for name, interface in INTERFACES.items():
        kind = name.partition("/")[0]
        files.append(f"{name}.{kind}")
        file = folder / files[-1]
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(interface.replace(", ", "\n") + "\n")
    (folder / "CMakeLists.txt").write_text(CMAKE.replace("FILES", " ".join(files)))
    (folder / "package.xml").write_text(PACKAGE)


if __name__ == "__main__":
    main()
