#!/usr/bin/env bash
# Makes .ros1: the Python of .venv with Debian's rospy, crtk_msgs, cisst_msgs and PyKDL beside what .venv has, so that
# trocar speaks ROS 1 and has a test partner. Needs Debian or Ubuntu, root, and a .venv of the same Python as the system's.
set -euo pipefail
cd "$(dirname "$0")/.."
fail() { echo "no ROS 1 here: $1" >&2; exit 1; }

[ -x .venv/bin/python ] || fail "there is no .venv: run make test first"
[ -x /usr/bin/python3 ] || fail "the system has no /usr/bin/python3"
version='import sys; print("%d.%d" % sys.version_info[:2])'
ours=$(.venv/bin/python -c "$version") system=$(/usr/bin/python3 -c "$version")
[ "$ours" = "$system" ] || fail ".venv has Python $ours and the system $system: make .venv anew with PYTHON=/usr/bin/python3"

packages="python3-rospy python3-rosmaster python3-std-msgs python3-geometry-msgs python3-sensor-msgs python3-genpy"
packages="$packages ros-std-msgs ros-geometry-msgs python3-pykdl"
if ! dpkg -s $packages >/dev/null 2>&1; then
  command -v apt-get >/dev/null || fail "there is no apt-get to install $packages"
  [ "$(id -u)" = 0 ] || fail "only root may install $packages"
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends $packages >/dev/null
fi

.venv/bin/python -m venv --clear --without-pip .ros1
cat >".ros1/lib/python$ours/site-packages/beside.pth" <<END
$PWD/src
import site; site.addsitedir("$PWD/.venv/lib/python$ours/site-packages")
/usr/lib/python3/dist-packages
END

build=$(mktemp -d)
trap 'rm -rf "$build"' EXIT
.ros1/bin/python tools/crtk_msgs.py "$build"
search=$(for name in std_msgs geometry_msgs; do echo "-I$name:/usr/share/$name/msg"; done)
for files in "$build"/*/msg "$build"/*/srv; do
  package=$(basename "$(dirname "$files")") kind=$(basename "$files")
  into=".ros1/lib/python$ours/site-packages/$package" make=".ros1/bin/python /usr/lib/genpy/gen${kind}_py.py"
  mkdir -p "$into/$kind"
  touch "$into/__init__.py"
  $make -p "$package" "-I$package:$build/$package/msg" $search -o "$into/$kind" "$files"/*."$kind"
  $make --initpy -p "$package" -o "$into/$kind"
done
.ros1/bin/python -c "import cisst_msgs.msg, crtk_msgs.srv, cyclonedds, mujoco, numpy, rospy, sensor_msgs.msg, trio, PyKDL
assert numpy.__version__ >= '2', numpy.__file__
print('rospy is ready in .ros1')"
