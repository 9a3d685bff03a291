"""The same recording gives the same manipulability from a table and from JIGSAWS, which says what was assumed.

Whatever is wrong with a set of demonstrations is said in one sentence that names the file and the remedy.
"""

from importlib.resources import files

import numpy as np
import pytest
from numpy.testing import assert_allclose

from synthetic_sutures import PLACES, SECOND_BASE, SEED, SETUP, synthetic_suture, write_synthetic
from trocar.arms import PSM_CLASSIC, fk, manipulability
from trocar.errors import BadFile, TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.suture.demonstrations import load_demonstrations, synthetic_demonstrations

ARM = PSM_CLASSIC
THETAS_DEG = (10, 200)
TWO = 'arms = ["psm-classic", "psm-classic"]\n'
HEADER = [f"psm{a}_q{i}" for a in (1, 2) for i in range(1, 7)]
SUTURES = [synthetic_suture(np.radians(theta), np.random.default_rng(theta)) for theta in THETAS_DEG]
EXPECTED = np.array([(manipulability(ARM, q) ** 2).mean(0) for q in SUTURES]).T
BASES = (SETUP.T_world_base, SECOND_BASE)
DEGREES = np.tile([180 / np.pi, 180 / np.pi, 1.0, *[180 / np.pi] * 3], 2)
MILLIMETRES = np.tile([1.0, 1.0, 1e3, 1.0, 1.0, 1.0], 2)
SHIPPED = files("trocar.tasks.suture.demonstrations") / "synthetic_set"


def manifest(folder, text):
    (folder / "demonstrations.toml").write_text(text)
    return folder


def entry(file="a.csv", theta="0", more=""):
    return f'\n[[sutures]]\nfile = "{file}"\ntheta_deg = {theta}\n{more}\n'


def table(folder, values, name="a.csv", header=HEADER):
    np.savetxt(folder / name, values, delimiter=",", header=",".join(header), comments="", fmt="%.9f")


def read(folder, head, files=("a.csv", "b.csv"), more=("", "")):
    entries = [entry(*parts) for parts in zip(files, THETAS_DEG, more, strict=True)]
    return load_demonstrations(manifest(folder, head + "".join(entries)))


def check(demos, expected=EXPECTED, rtol=1e-6):
    assert_allclose(np.degrees(demos.places_rad), THETAS_DEG)
    assert_allclose(demos.per_arm, expected, rtol=rtol)


def says(folder, *words):
    with pytest.raises(TrocarError) as caught:
        load_demonstrations(folder)
    for word in words:
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


# Tables.


@pytest.mark.parametrize("names", [[joint.name for joint in ARM.joints], [f"q{i}" for i in range(1, 7)]])
def test_joints_are_found_by_their_names_in_any_order(tmp_path, names):
    header = np.array(["time_s", *(f"psm{a}_{name}" for a in (1, 2) for name in names)])
    order = np.r_[0, 6:0:-1, 12:6:-1]
    for file, q in zip("ab", SUTURES, strict=True):
        values = np.hstack([np.arange(len(q))[:, None], q.reshape(-1, 12)])
        table(tmp_path, values[:, order], f"{file}.csv", header[order])
    check(read(tmp_path, TWO))


def test_joints_may_be_in_degrees_and_mm(tmp_path):
    for file, q in zip("ab", SUTURES, strict=True):
        table(tmp_path, q.reshape(-1, 12) * DEGREES * MILLIMETRES, f"{file}.csv")
    check(read(tmp_path, f'{TWO}angles = "deg"\nlengths = "mm"\n'))


def test_rows_cut_one_suture_out_of_a_long_recording_of_one_arm(tmp_path):
    table(tmp_path, np.vstack([q[:, 1] for q in SUTURES]), header=HEADER[:6])
    n = len(SUTURES[0])
    rows = f"rows = [0, {n}]", f"rows = [{n}, {2 * n}]"
    check(read(tmp_path, 'arms = ["psm-classic"]\n', ("a.csv", "a.csv"), rows), EXPECTED[1:])


# JIGSAWS.


def jigsaws(folder, bases=BASES, scale=1.0, digits=9, turn=None):
    """Write what JIGSAWS would have recorded: poses of the tips, rounded, among columns that must not matter."""
    rng, turn = np.random.default_rng(0), turn or SO3.identity()
    for name, q in zip("ab", SUTURES, strict=True):
        text = rng.normal(size=(len(q), 76))
        for start, a in ((38, 0), (57, 1)):
            pose = bases[a] @ fk(ARM, q[:, a])
            text[:, start : start + 3] = scale * pose.translation_m
            text[:, start + 3 : start + 12] = (pose.rotation @ turn).matrix.reshape(-1, 9)
        np.savetxt(folder / f"{name}.txt", text, fmt=f"%.{digits}f")


def with_bases(bases=BASES):
    return "\n" + "".join(
        f"[[bases]]\nxyz_m = {base.translation_m.tolist()}\nwxyz = {base.rotation.as_quaternion().tolist()}\n"
        for base in bases
    )


def test_known_bases_give_the_joints_back_from_rounded_poses(tmp_path):
    move = SE3.from_parts(SO3.exp([0.3, -0.5, 1.1]), [0.1, 0.2, -0.3])
    moved = [move @ base for base in BASES]
    jigsaws(tmp_path, moved, digits=6)
    demos = read(tmp_path, TWO, ("a.txt", "b.txt"), ("", with_bases(moved)))
    check(demos, rtol=1e-3)
    assert "bases as given in the manifest; 0 % of the poses then lie outside" in demos.source


def test_without_bases_the_source_says_what_was_assumed_wherever_the_frame_is(tmp_path):
    found = []
    for move in (SE3.identity(), SE3.from_parts(SO3.exp([2.0, 0.4, -1.0]), [1.0, -2.0, 0.5])):
        jigsaws(tmp_path, [move @ base for base in BASES])
        found.append(read(tmp_path, TWO, ("a.txt", "b.txt")))
        assert "assumed bases" in found[-1].source
    assert_allclose(found[0].per_arm, found[1].per_arm, rtol=1e-4)


def test_positions_in_mm_and_another_frame_of_the_tip_are_read_as_the_manifest_says(tmp_path):
    jigsaws(tmp_path, scale=1e3, turn=SO3.axis("x", np.pi))  # z along the jaws instead of back
    head = f'{TWO}lengths = "mm"\nrecorded_tip_wxyz = [0, 1, 0, 0]\n'
    check(read(tmp_path, head, ("a.txt", "b.txt"), ("", with_bases())), rtol=1e-4)


@pytest.mark.parametrize(("scale", "unit"), [(1e3, "m"), (1.0, "mm")])
def test_positions_in_another_unit_are_refused(tmp_path, scale, unit):
    jigsaws(tmp_path, scale=scale)
    with pytest.raises(BadFile, match=r"spread over .* and .*; a suture takes 0.3 mm to .*check the units"):
        read(tmp_path, f'{TWO}lengths = "{unit}"\n', ("a.txt", "b.txt"))


def test_two_arms_and_bases_that_can_reach_are_needed(tmp_path):
    row = np.zeros(76)
    row[38:50] = row[57:69] = np.hstack([[0.0, 0.0, 0.0], np.eye(3).ravel()])
    rows = np.tile(row, (3, 1))
    rows[1, 38] = 1e-3
    np.savetxt(tmp_path / "a.txt", rows)
    says(manifest(tmp_path, 'arms = ["psm-classic"]\n' + entry("a.txt")), "two slaves", "name two")
    inside = "[[bases]]\nxyz_m = [0, 0, 0.0095]\n" * 2  # the jaw axis on the remote centre: no definite joints
    says(manifest(tmp_path, TWO + entry("a.txt") + inside), "a.txt", "cannot be reached", "bases")


# What is refused.

Q = SUTURES[0].reshape(-1, 12)
ONE_ROW = ",".join(HEADER) + "\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("arms = [", ("cannot be read as TOML",)),
        (TWO, ("demonstrations has no key 'sutures'",)),
        ("sutures = []\n" + TWO, ("demonstrations.sutures is []",)),
        (TWO + "color = 3\n" + entry(), ("unknown key 'color'", "arms")),
        (entry(), ("no key 'arms'",)),
        ('arms = ["psm"]\n' + entry(), ("'psm'", "psm-classic")),
        ("arms = []\n" + entry(), ("demonstrations.arms is []", "at least 1")),
        (TWO + 'angles = "degrees"\n' + entry(), ("'degrees'", "'rad' or 'deg'")),
        (TWO + "lengths = 3\n" + entry(), ("lengths is 3", "'m' or 'mm'")),
        (TWO + "source = 3\n" + entry(), ("source is 3",)),
        (TWO + "recorded_tip_wxyz = [0, 0, 0, 0]\n" + entry(), ("a quaternion is zero",)),
        (TWO + entry() + "[[bases]]\nxyz_m = [0, 0, 1]\n", ("1 bases", "2 arm(s)")),
        (TWO + entry() + "[[bases]]\nxyz_m = [0, 1]\n", ("bases.xyz_m is [0, 1]", "at least 3")),
        (TWO + entry(theta="nan"), ("sutures.theta_deg is nan",)),
        (TWO + entry(theta='"left"'), ("theta_deg is 'left'",)),
        (TWO + "[[sutures]]\ntheta_deg = 0\n", ("sutures has no key 'file'",)),
        (TWO + entry(more="rows = [5, 2]"), ("rows of a.csv are [5, 2]",)),
        (TWO + entry(more="rows = [0, 900]"), ("0 to 900", "24 rows")),
        (TWO + entry(more="rows = [10, 25]"), ("10 to 25", "has 24 rows")),
        (TWO + entry(more="rows = [3, 4]"), ("1 row(s)", "2 or more")),
        (TWO + entry("b.csv"), ("b.csv", "does not exist")),
        (TWO + entry("a.mat"), ("'.mat'", ".csv or .txt")),
    ],
)
def test_a_wrong_manifest(tmp_path, text, words):
    table(tmp_path, Q)
    says(manifest(tmp_path, text), *words)


@pytest.mark.parametrize("path", ["nowhere", "."])
def test_no_manifest(tmp_path, path):
    says(tmp_path / path, "does not exist", "demonstrations.toml" if path == "." else "nowhere")


def changed(row, column, value):
    q = Q.copy()
    q[row, column] = value
    return q


@pytest.mark.parametrize(
    ("values", "head", "words"),
    [
        (Q * DEGREES, "", ("a.csv", "arm 1", " deg in row", "units (angles")),
        (Q * MILLIMETRES, "", ("'insertion'", " mm in row 0", "outside [0.0 mm, 240.0 mm]", "lengths in its manifest")),
        (Q, 'angles = "deg"\n', ("no angle that changes", "too little for a suture", "units")),
        (Q * DEGREES, 'angles = "deg"\nlengths = "mm"\n', ("no insertion that exceeds", "units")),
        (changed(7, 8, 0.9), "", ("arm 2", "'insertion'", "900.0 mm in row 7", "order of the columns")),
        (changed(5, 10, np.nan), "", ("row 5", "'wrist_pitch' of psm-classic, arm 2", "nan deg")),
    ],
)
def test_numbers_that_cannot_be_joints(tmp_path, values, head, words):
    table(tmp_path, values)
    says(manifest(tmp_path, TWO + head + entry()), *words)


def test_a_joint_a_little_beyond_its_limit_is_kept(tmp_path):
    table(tmp_path, changed(3, 2, 0.2403), "b.csv")  # recorded on a real PSM: 0.2403 m beyond the nominal .24
    table(tmp_path, Q)
    assert len(read(tmp_path, TWO).places_rad) == 2


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", "", ("a.csv", "is empty")),
        ("a.csv", "\n", ("is empty", "psm1_yaw")),
        ("a.csv", "0.1,0.2\n0.1,0.2\n", ("does not name its columns", "psm1_yaw")),
        ("a.csv", "time,q1,q2\n0,1,2\n", ("time, q1, q2", "psm1_yaw")),
        ("a.csv", f"{ONE_ROW}{'0,' * 11}x\n", ("row 2", "'x'")),
        ("a.csv", ONE_ROW, ("0 row(s)",)),
        ("a.txt", "1 2 3\n4 5 6\n", ("3 columns", "76")),
        ("a.txt", "1 2\n4 5 6\n", ("not a text of 76",)),
        ("a.txt", "# nothing\n", ("a.txt",)),
        ("a.txt", ("0 " * 76 + "\n") * 3, ("a rotation in row 0", "not JIGSAWS' columns")),
        ("a.txt", ("nan " * 76 + "\n") * 3, ("NaN", "row 0")),
        ("a.txt", "1 " * 76, ("1 row(s)",)),
    ],
)
def test_broken_files(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content.encode("latin-1"))
    says(manifest(tmp_path, TWO + entry(name)), *words)


# The set that ships.


def test_the_shipped_set_is_what_the_tool_writes_two_sutures_at_each_of_eight_places_by_two_arms(tmp_path):
    write_synthetic(tmp_path, np.random.default_rng(SEED))
    for file in SHIPPED.iterdir():
        if file.name.endswith(".csv"):
            old, new = (np.loadtxt(str(where / file.name), delimiter=",", skiprows=1) for where in (SHIPPED, tmp_path))
            assert_allclose(old, new, atol=2e-4)
        else:
            assert (tmp_path / file.name).read_text().startswith(file.read_text())
    demos = synthetic_demonstrations()
    assert_allclose(np.degrees(demos.places_rad), np.arange(0, 360, 45), atol=1e-9)
    assert len(list(SHIPPED.iterdir())) == 2 * PLACES + 1 and demos.per_arm.shape == (2, PLACES)
    assert demos.source.startswith("synthetic")
    assert sum(len(file.read_bytes()) for file in SHIPPED.iterdir()) < 60_000
