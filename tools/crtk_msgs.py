"""Write the parts of the ROS packages ``crtk_msgs`` and ``cisst_msgs`` that clients of a served arm need.

No package index has them. ``tools/ros1.sh`` and ``tools/ros2.sh`` generate Python from them for their test partners.
"""

import sys
from pathlib import Path

GAINS = "crtk_msgs/CartesianImpedanceHalfPlaneGains"
TIMES = [f"{what}_{of}" for what in ("period", "compute_time") for of in ("avg", "std_dev", "min", "max")]
CRTK = {
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
CISST = {
    "msg/IntervalStatistics": f"std_msgs/Header header, {', '.join(f'float64 {name}' for name in TIMES)}, "
    "int64 number_of_samples, int64 number_of_overruns, float64 statistics_interval, int64 user_data"
}
PACKAGES = {"crtk_msgs": CRTK, "cisst_msgs": CISST}
"""Fields of each message and service of crtk_msgs 1.3, and of cisst_msgs 4.0 that an arm publishes."""
CMAKE = """cmake_minimum_required(VERSION 3.16)
project(PACKAGE)
find_package(ament_cmake REQUIRED)
foreach(step rosidl_cmake rosidl_generator_type_description rosidl_generator_c rosidl_typesupport_introspection_c
    rosidl_typesupport_fastrtps_c rosidl_typesupport_c rosidl_generator_py)
  find_package(${step} REQUIRED)
endforeach()
find_package(std_msgs REQUIRED)
find_package(geometry_msgs REQUIRED)
rosidl_generate_interfaces(PACKAGE FILES DEPENDENCIES std_msgs geometry_msgs)
ament_package()
"""
MANIFEST = """<package format="3"><name>PACKAGE</name><version>1.3.0</version><description>of CRTK</description>
<maintainer email="nobody@example.org">nobody</maintainer><license>MIT</license>
<member_of_group>rosidl_interface_packages</member_of_group></package>
"""


def main() -> None:
    """Write them into the folder named on the command line."""
    for package, interfaces in PACKAGES.items():
        folder, files = Path(sys.argv[1]) / package, []
        for name, interface in interfaces.items():
            kind = name.partition("/")[0]
            files.append(f"{name}.{kind}")
            file = folder / files[-1]
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(interface.replace(", ", "\n") + "\n")
        cmake = CMAKE.replace("FILES", " ".join(files)).replace("PACKAGE", package)
        (folder / "CMakeLists.txt").write_text(cmake)
        (folder / "package.xml").write_text(MANIFEST.replace("PACKAGE", package))


if __name__ == "__main__":
    main()
