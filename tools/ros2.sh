#!/usr/bin/env bash
# Makes .ros2: Python 3.12 with the real rclpy (ROS 2 Kilted, Fast DDS), crtk_msgs and cisst_msgs, a partner for trocar.crtk.
# With --clients also PyKDL, which the public CRTK clients need (Debian or Ubuntu, root).
set -euo pipefail
cd "$(dirname "$0")/.."
fail() { echo "no ROS 2 here: $1" >&2; exit 1; }

clients=${1:-}
[ -z "$clients" ] || [ "$clients" = --clients ] || fail "the only option is --clients, not $clients"
for python in python3.12 "$(pyenv root 2>/dev/null)"/versions/3.12*/bin/python3.12 none; do
  [ "$python" != none ] || fail "there is no Python 3.12, for which the wheels are"
  ! "$python" -c "import ensurepip, venv" 2>/dev/null || break
done
for tool in cmake g++; do command -v $tool >/dev/null || fail "$tool is needed to build crtk_msgs"; done

"$python" -m venv --clear .ros2
pip() { .ros2/bin/python -m pip install --quiet --disable-pip-version-check "$@" 2>&1 | { grep -v "is ignored: it is neither" || true; }; }
pip ros-kilted-rclpy==9.1.2 ros-kilted-rmw-fastrtps-cpp==9.3.3 ros-kilted-sensor-msgs==5.5.1 \
  ros-kilted-geometry-msgs==5.5.1 ros-kilted-std-msgs==5.5.1 ros-ament-cmake==2.7.3 ros-ament-package==0.17.2 \
  ros-ament-cmake-include-directories==2.7.3 ros-ament-cmake-ros-core==0.14.5 catkin-pkg==1.1.1

# crtk_msgs and cisst_msgs. The wheels name folders of the machine that built them.
site=$(.ros2/bin/python -c "import sysconfig; print(sysconfig.get_path('purelib'))")
include=$(.ros2/bin/python -c "import sysconfig; print(sysconfig.get_path('include'))")
sed -i "s#/opt/python/[^;\"]*/site-packages#$site#; s#/opt/python/[^;\"]*/include/python3.12#$include#" \
  .ros2/share/*/cmake/*_pyExport.cmake
build=$(mktemp -d)
trap 'rm -rf "$build"' EXIT
.ros2/bin/python tools/crtk_msgs.py "$build"
(
  export PATH="$PWD/.ros2/bin:$PATH" AMENT_PREFIX_PATH="$PWD/.ros2"
  for package in crtk_msgs cisst_msgs; do
    cmake -S "$build/$package" -B "$build/out/$package" -DCMAKE_PREFIX_PATH="$PWD/.ros2" \
      -DCMAKE_INSTALL_PREFIX="$PWD/.ros2" -DPython3_EXECUTABLE="$PWD/.ros2/bin/python" &&
      cmake --build "$build/out/$package" -j "$(nproc)" && cmake --install "$build/out/$package" || exit 1
  done
) >"$build/log" 2>&1 || { tail -30 "$build/log" >&2; fail "the messages could not be built"; }
.ros2/bin/python -c "import cisst_msgs.msg, crtk_msgs.msg, rclpy, sensor_msgs.msg; print('rclpy is ready in .ros2')"
[ "$clients" ] || exit 0

packages="liborocos-kdl-dev dpkg-dev"
if ! dpkg -s $packages >/dev/null 2>&1; then
  [ "$(id -u)" = 0 ] || fail "only root may install $packages"
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends $packages >/dev/null
fi
pip pybind11==3.1.0

# PyKDL's source, from the machine's own Debian archive: its deb-src, in lists of their own
lists="$build/apt"
mkdir -p "$lists/sources" "$lists/state/partial"
for file in /etc/apt/sources.list /etc/apt/sources.list.d/*.list /etc/apt/sources.list.d/*.sources; do
  [ ! -e "$file" ] || sed 's/^Types: deb$/Types: deb-src/; s/^deb /deb-src /' "$file" >"$lists/sources/$(basename "$file")"
done
archive=(-o "Dir::Etc::SourceList=/dev/null" -o "Dir::Etc::SourceParts=$lists/sources" -o "Dir::State::Lists=$lists/state")
apt-get "${archive[@]}" update >/dev/null 2>&1 || true
(cd "$lists" && apt-get "${archive[@]}" source -qq --only-source orocos-kdl >/dev/null 2>&1) ||
  fail "the archives of this machine have no source of orocos-kdl"
# shellcheck disable=SC2046
g++ -O1 -shared -fPIC -std=c++17 -fvisibility=hidden $(.ros2/bin/python -m pybind11 --includes) -I/usr/include/eigen3 \
  -I/usr/include/kdl "$lists"/orocos-kdl-*/python_orocos_kdl/PyKDL/*.cpp -lorocos-kdl -o "$site/PyKDL.so"
.ros2/bin/python -c "import PyKDL; print('PyKDL is ready in .ros2')"
