"""The same recording, written in every format, gives the same manipulability; JIGSAWS says what was assumed."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import PSM_CLASSIC, fk, manipulability
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.suture.demonstrations import load_demonstrations
from trocar.tasks.suture.demonstrations.synthetic import SECOND_BASE, SETUP, synthetic_suture

ARM = PSM_CLASSIC
THETAS_DEG = (10, 200)
TWO = 'arms = ["psm-classic", "psm-classic"]\n'


@pytest.fixture
def sutures():
    return [synthetic_suture(np.radians(theta), np.random.default_rng(theta)) for theta in THETAS_DEG]


@pytest.fixture
def expected(sutures):
    return np.array([(manipulability(ARM, q) ** 2).mean(0) for q in sutures]).T


def write_set(folder, head, files, more=("", "")):
    entries = [
        f'\n[[sutures]]\nfile = "{file}"\ntheta_deg = {theta}\n{extra}'
        for file, theta, extra in zip(files, THETAS_DEG, more, strict=True)
    ]
    (folder / "demonstrations.toml").write_text(head + "".join(entries))
    return folder


def csv_of(path, header, values):
    np.savetxt(path, values, delimiter=",", header=",".join(header), comments="", fmt="%.9f")


def check(folder, expected, rtol=1e-6):
    demos = load_demonstrations(folder)
    assert_allclose(np.degrees(demos.places_rad), THETAS_DEG)
    assert_allclose(demos.per_arm, expected, rtol=rtol)
    return demos


def test_npy_of_two_arms(tmp_path, sutures, expected):
    for name, q in zip("ab", sutures, strict=True):
        np.save(tmp_path / f"{name}.npy", q.reshape(-1, 12))
    check(write_set(tmp_path, TWO, ("a.npy", "b.npy")), expected)


def test_npz_by_name_or_alone_of_one_arm_and_the_manifest_file_itself(tmp_path, sutures, expected):
    np.savez(tmp_path / "a.npz", t_s=np.arange(len(sutures[0])), q=sutures[0][:, 1])
    np.savez(tmp_path / "b.npz", whatever=sutures[1][:, 1])
    write_set(tmp_path, 'arms = ["psm-classic"]\n', ("a.npz", "b.npz"))
    check(tmp_path / "demonstrations.toml", expected[1:])


def test_columns_by_number_pass_over_the_jaws(tmp_path, sutures, expected):
    for name, q in zip("ab", sutures, strict=True):
        jaw = np.full((len(q), 1), 9.0)
        np.save(tmp_path / f"{name}.npy", np.hstack([q[:, 0], jaw, q[:, 1], jaw]))
    head = TWO + "columns = [0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 12]\n"
    check(write_set(tmp_path, head, ("a.npy", "b.npy")), expected)


@pytest.mark.parametrize("names", [[joint.name for joint in ARM.joints], [f"q{i}" for i in range(1, 7)]])
def test_csv_finds_joints_by_their_names_in_any_order(tmp_path, sutures, expected, names):
    for file, q in zip("ab", sutures, strict=True):
        header = [f"psm{a}_{name}" for a in (1, 2) for name in names]
        values = np.hstack([np.arange(len(q))[:, None], q.reshape(-1, 12)])
        order = np.r_[0, 1 + np.array([0, 5, 4, 3, 2, 1]), 1 + np.array([11, 10, 9, 8, 7, 6])]
        header = ["time_s", *[header[i - 1] for i in order[1:]]]
        csv_of(tmp_path / f"{file}.csv", header, values[:, order])
    check(write_set(tmp_path, TWO, ("a.csv", "b.csv")), expected)


def test_csv_with_columns_named_in_the_manifest_in_degrees_and_mm(tmp_path, sutures, expected):
    shown = np.tile([180 / np.pi, 180 / np.pi, 1e3, *[180 / np.pi] * 3], 2)
    header = [f"field.position{i}" for i in range(12)]
    for file, q in zip("ab", sutures, strict=True):
        csv_of(tmp_path / f"{file}.csv", header, q.reshape(-1, 12) * shown)
    head = TWO + f'angles = "deg"\nlengths = "mm"\ncolumns = {header}\n'
    check(write_set(tmp_path, head, ("a.csv", "b.csv")), expected)


def test_rows_cut_one_suture_out_of_a_long_recording(tmp_path, sutures, expected):
    np.save(tmp_path / "both.npy", np.vstack([q.reshape(-1, 12) for q in sutures]))
    n = len(sutures[0])
    rows = f"rows = [0, {n}]\n", f"rows = [{n}, {2 * n}]\n"
    check(write_set(tmp_path, TWO, ("both.npy", "both.npy"), rows), expected)


def test_parquet_of_lerobot_by_episode_and_columns(tmp_path, sutures, expected):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    states = [np.hstack([q[:, 0], np.ones((len(q), 1)), q[:, 1]]).astype(np.float32) for q in sutures]
    lengths = [len(state) for state in states]
    table = pa.table(
        {
            "observation.state": pa.array(np.vstack(states).tolist(), pa.list_(pa.float32(), 13)),
            "episode_index": np.repeat([4, 7], lengths),
        }
    )
    pq.write_table(table, tmp_path / "file-000.parquet")
    head = TWO + "columns = [0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 12]\n"
    more = "episode = 4\n", "episode = 7\n"
    check(write_set(tmp_path, head, ("file-000.parquet",) * 2, more), expected, rtol=1e-4)


def jigsaws_of(path, sutures_q, T_frame_bases, digits=6):
    """Write what JIGSAWS would have recorded: poses of the tips, rounded, among columns that must not matter."""
    rng = np.random.default_rng(0)
    text = rng.normal(size=(len(sutures_q), 76))
    for start, a in ((38, 0), (57, 1)):
        pose = (T_frame_bases[a] @ fk(ARM, sutures_q[:, a])).matrix
        text[:, start : start + 3] = pose[:, :3, 3]
        text[:, start + 3 : start + 12] = pose[:, :3, :3].reshape(-1, 9)
    np.savetxt(path, text, fmt=f"%.{digits}f")


BASES = (SETUP.T_world_base, SECOND_BASE)


def bases_toml(bases):
    return "".join(
        f"\n[[bases]]\nxyz_m = {base.translation_m.tolist()}\nwxyz = {base.rotation.as_quaternion().tolist()}\n"
        for base in bases
    )


def test_jigsaws_with_known_bases_gives_the_joints_back(tmp_path, sutures, expected):
    move = SE3.from_parts(SO3.exp([0.3, -0.5, 1.1]), [0.1, 0.2, -0.3])
    for name, q in zip("ab", sutures, strict=True):
        jigsaws_of(tmp_path / f"{name}.txt", q, [move @ base for base in BASES])
    folder = write_set(tmp_path, TWO, ("a.txt", "b.txt"))
    with (folder / "demonstrations.toml").open("a") as file:
        file.write(bases_toml([move @ base for base in BASES]))
    demos = check(folder, expected, rtol=1e-3)
    assert "bases as given in the manifest; 0 % of the poses then lie outside" in demos.source


def test_jigsaws_without_bases_says_what_it_assumed_wherever_the_frame_is(tmp_path, sutures):
    moves = SE3.identity(), SE3.from_parts(SO3.exp([2.0, 0.4, -1.0]), [1.0, -2.0, 0.5])
    found = []
    for number, move in enumerate(moves):
        folder = tmp_path / str(number)
        folder.mkdir()
        for name, q in zip("ab", sutures, strict=True):
            jigsaws_of(folder / f"{name}.txt", q, [move @ base for base in BASES], digits=9)
        demos = load_demonstrations(write_set(folder, TWO, ("a.txt", "b.txt")))
        assert "assumed bases" in demos.source
        found.append(demos.per_arm)
    assert_allclose(*found, rtol=1e-4)  # nothing depends on where the recording's frame is


@pytest.mark.parametrize(
    "scale, said, words",
    [(1e3, "m", r'slave spread over .* m, .*lengths = "mm"'), (1.0, "mm", r'mm only.*lengths = "m"')],
)
def test_jigsaws_in_another_unit_than_said_is_refused_with_the_right_one(tmp_path, sutures, scale, said, words):
    for name, q in zip("ab", sutures, strict=True):
        jigsaws_of(tmp_path / f"{name}.txt", q, BASES, digits=9)
        scaled_places(tmp_path / f"{name}.txt", scale)
    with pytest.raises(TrocarError, match=words):
        load_demonstrations(write_set(tmp_path, f'{TWO}lengths = "{said}"\n', ("a.txt", "b.txt")))


def test_jigsaws_in_mm_is_read_in_mm(tmp_path, sutures, expected):
    for name, q in zip("ab", sutures, strict=True):
        jigsaws_of(tmp_path / f"{name}.txt", q, BASES, digits=9)
        scaled_places(tmp_path / f"{name}.txt", 1e3)
    folder = write_set(tmp_path, f'{TWO}lengths = "mm"\n', ("a.txt", "b.txt"))
    with (folder / "demonstrations.toml").open("a") as file:
        file.write(bases_toml(BASES))
    check(folder, expected, rtol=1e-4)


def scaled_places(path, scale):
    text = np.loadtxt(path)
    for start in (38, 57):
        text[:, start : start + 3] *= scale
    np.savetxt(path, text, fmt="%.9f")


def test_the_recorded_tips_frame_may_be_another(tmp_path, sutures, expected):
    turn = SO3.axis("x", np.pi)  # z along the jaws instead of back
    for name, q in zip("ab", sutures, strict=True):
        jigsaws_of(tmp_path / f"{name}.txt", q, BASES, digits=9)
        text = np.loadtxt(tmp_path / f"{name}.txt")
        for start in (41, 60):
            R = text[:, start : start + 9].reshape(-1, 3, 3) @ turn.inverse().matrix
            text[:, start : start + 9] = R.reshape(-1, 9)
        np.savetxt(tmp_path / f"{name}.txt", text)
    head = TWO + "recorded_tip_wxyz = [0, 1, 0, 0]\n"
    folder = write_set(tmp_path, head, ("a.txt", "b.txt"))
    with (folder / "demonstrations.toml").open("a") as file:
        file.write(bases_toml(BASES))
    check(folder, expected, rtol=1e-4)
