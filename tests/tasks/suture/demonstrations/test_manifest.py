"""Whatever is wrong with a set of demonstrations is said in one sentence that names the file and the remedy."""

import builtins

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.tasks.suture.demonstrations import load_demonstrations
from trocar.tasks.suture.demonstrations.synthetic import synthetic_suture

TWO = 'arms = ["psm-classic", "psm-classic"]\n'
Q = synthetic_suture(0.3, np.random.default_rng(1)).reshape(-1, 12)
HEADER = ",".join(f"psm{a}_q{i}" for a in (1, 2) for i in range(1, 7))


def manifest(folder, text):
    (folder / "demonstrations.toml").write_text(text)
    return folder


def entry(file, theta="0", more=""):
    return f'\n[[sutures]]\nfile = "{file}"\ntheta_deg = {theta}\n{more}\n'


def says(folder, *words):
    with pytest.raises(TrocarError) as caught:
        load_demonstrations(folder)
    sentence = str(caught.value)
    assert "\n" not in sentence
    for word in words:
        assert word in sentence, sentence


def recorded(folder, values, head=TWO, name="a.npy"):
    np.save(folder / name, values)
    return manifest(folder, head + entry(name))


@pytest.mark.parametrize("path", ["nowhere", "."])
def test_no_manifest(tmp_path, path):
    says(tmp_path / path, "do not exist", "demonstrations.toml" if path == "." else "nowhere")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("arms = [", ("cannot be read as TOML",)),
        (TWO, ("lists no sutures", "[[sutures]]")),
        (TWO + "color = 3\n" + entry("a.npy"), ("unknown key 'color'", "arms")),
        (entry("a.npy"), ("arms is None", "psm-classic")),
        ('arms = ["psm"]\n' + entry("a.npy"), ("'psm'", "psm-classic")),
        ("arms = []\n" + entry("a.npy"), ("no arm",)),
        (TWO + 'angles = "degrees"\n' + entry("a.npy"), ("'degrees'", "rad, deg")),
        (TWO + "lengths = 3\n" + entry("a.npy"), ("lengths is 3", "a word")),
        (TWO + "angles = []\n" + entry("a.npy"), ("angles is []", "'rad'")),
        (TWO + "state = 3\n" + entry("a.npy"), ("state", "3")),
        (TWO + "source = 3\n" + entry("a.npy"), ("source is 3",)),
        (TWO + "columns = [0, 1]\n" + entry("a.npy"), ("2 columns", "12")),
        (TWO + 'columns = [0, "q"]\n' + entry("a.npy"), ("columns is", "numbers from 0, or names")),
        (TWO + "recorded_tip_wxyz = [0, 0, 0, 0]\n" + entry("a.npy"), ("recorded_tip_wxyz", "4 finite numbers")),
        (TWO + entry("a.npy") + "[[bases]]\nxyz_m = [0, 0, 1]\n", ("1 bases", "2 arm(s)")),
        (TWO + entry("a.npy") + "[[bases]]\nxyz_m = [0, 1]\n", ("base 1: xyz_m", "3 finite numbers")),
        (TWO + '[[sutures]]\nfile = "a.npy"\n', ("suture 1 (a.npy)", "theta_deg = None")),
        (TWO + entry("a.npy", "nan"), ("theta_deg = nan",)),
        (TWO + entry("a.npy", '"left"'), ("theta_deg = 'left'",)),
        (TWO + "[[sutures]]\ntheta_deg = 0\n", ("suture 1 has the file None",)),
        (TWO + entry("a.npy", more="rows = [5, 2]"), ("rows = [5, 2]",)),
        (TWO + entry("a.npy", more="rows = [0, 900]"), ("rows 0 to 900", "24 rows")),
        (TWO + entry("a.npy", more="rows = [3, 4]"), ("1 row(s)", "2 or more")),
        (TWO + entry("a.npy", more="episode = 1"), ("no episodes",)),
        (TWO + entry("a.npy", more='episode = "x"'), ("episode = 'x'",)),
        (TWO + entry("b.npy"), ("b.npy", "does not exist")),
        (TWO + entry("a.mat"), ("'.mat'", ".npy, .npz, .csv, .txt, .parquet")),
        (TWO + entry("a.npy") + entry("a.npy", "360"), ("1 place", "two or more")),
    ],
)
def test_a_wrong_manifest(tmp_path, text, words):
    np.save(tmp_path / "a.npy", Q)
    says(manifest(tmp_path, text), *words)


def changed(row, column, value):
    q = Q.copy()
    q[row, column] = value
    return q


DEGREES = np.tile([180 / np.pi, 180 / np.pi, 1.0, *[180 / np.pi] * 3], 2)
MILLIMETRES = np.tile([1.0, 1.0, 1e3, 1.0, 1.0, 1.0], 2)


@pytest.mark.parametrize(
    ("values", "head", "words"),
    [
        (Q * DEGREES, TWO, ("a.npy, arm 1", " rad at row", "seems to be in deg", 'angles = "deg"')),
        (Q * MILLIMETRES, TWO, ("'insertion'", " m at row", "seems to be in mm", 'lengths = "mm"')),
        (Q, TWO + 'angles = "deg"\n', ("too little for a suture", "seems to be in rad", 'angles = "rad"')),
        (Q * DEGREES, TWO + 'angles = "deg"\nlengths = "mm"\n', ("seems to be in m;", 'lengths = "m"')),
        (Q * DEGREES * MILLIMETRES, TWO, ("seems to be in",)),
        (changed(7, 8, 0.9), TWO, ("arm 2", "'insertion'", "0.9 m at row 7", "order of the columns")),
        (changed(5, 10, np.nan), TWO, ("row 5", "'wrist_pitch' of arm 2", "NaN")),
        (changed(5, 10, np.inf), TWO, ("row 5", "infinity")),
        (Q[:, :7], TWO, ("7 columns", "12")),
        (Q, 'arms = ["psm-classic"]\n', ("12 columns", "need 6")),
        (Q[:0], TWO, ("0 row(s)",)),
        (Q[0], TWO, ("shape (12,)",)),
        (Q.astype(str), TWO, ("numbers",)),
        (Q, TWO + f"columns = {[*range(11), 12]}\n", ("columns 0 to 11, not 12",)),
        (Q, TWO + f"columns = {[f'q{i}' for i in range(12)]}\n", ("have no names",)),
    ],
)
def test_wrong_arrays(tmp_path, values, head, words):
    says(recorded(tmp_path, values, head), *words)


def test_a_joint_a_little_beyond_its_limit_is_kept(tmp_path):
    np.save(tmp_path / "b.npy", changed(3, 2, 0.2403))  # recorded on a real PSM: 0.2403 m beyond the nominal .24
    recorded(tmp_path, Q)
    load_demonstrations(manifest(tmp_path, TWO + entry("a.npy") + entry("b.npy", "90")))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.npy", b"", ("a.npy", "is empty")),
        ("a.npy", b"\x93NUMPY\x01", ("not a readable .npy",)),
        ("a.npz", b"PK\x03\x04", ("not a readable",)),
        ("a.csv", b"\n", ("is empty", "header")),
        ("a.csv", b"\xff\xfe\x00", ("not a readable CSV",)),
        ("a.csv", b"0.1,0.2\n0.1,0.2\n", ("no header",)),
        ("a.csv", b"time,q1,q2\n0,1,2\n", ("time, q1, q2", "psm1_yaw")),
        ("a.csv", b"q1,q1\n0,1\n", ("more than one column 'q1'",)),
        ("a.csv", f"{HEADER}\n{'0,' * 11}x\n".encode(), ("row 0", "'x' for psm2_q6")),
        ("a.csv", f"{HEADER}\n{'0,' * 11}\n".encode(), ("row 0", "'' for psm2_q6")),
        ("a.csv", f"{HEADER}\n0,1\n".encode(), ("row 0 has 2 values", "12")),
        ("a.csv", f"{HEADER}\n".encode(), ("0 row(s)",)),
        ("a.txt", b"1 2 3\n4 5 6\n", ("3 columns", "76")),
        ("a.txt", b"1 2\n4 5 6\n", ("not a readable text of 76",)),
        ("a.txt", b"# nothing\n", ("a.txt",)),
        ("a.txt", (b"0 " * 76 + b"\n") * 3, ("rotation of row 0", "not those of JIGSAWS")),
        ("a.txt", (b"nan " * 76 + b"\n") * 3, ("row 0 holds NaN",)),
        ("a.txt", b"1 " * 76, ("1 row(s)",)),
        ("a.parquet", b"PAR1", ("not a readable parquet",)),
    ],
)
def test_broken_files(tmp_path, name, content, words):
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow")
    (tmp_path / name).write_bytes(content)
    says(manifest(tmp_path, TWO + entry(name)), *words)


@pytest.mark.parametrize(
    ("columns", "more", "words"),
    [
        ({"action": Q.tolist()}, "", ("no column 'observation.state'", "action")),
        ({"observation.state": Q[:, 0].tolist()}, "", ("no lists",)),
        ({"observation.state": [[1.0], [1.0, 2.0]]}, "", ("differ in length",)),
        ({"observation.state": Q.tolist()}, "episode = 1", ("no column 'episode_index'",)),
        ({"observation.state": Q.tolist(), "episode_index": [0] * 24}, "episode = 1", ("no episode 1", "0 to 0")),
        ({"observation.state": Q.tolist(), "episode_index": [0, 1] * 12}, "", ("2 episodes", "name the episode")),
        ({"observation.state": Q[:, :6].tolist()}, "", ("6 columns", "12")),
    ],
)
def test_wrong_parquet(tmp_path, columns, more, words):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    says(manifest(tmp_path, TWO + entry("a.parquet", more=more)), *words)


def test_parquet_without_pyarrow_names_the_extra(tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    (tmp_path / "a.parquet").write_bytes(b"PAR1")
    says(manifest(tmp_path, TWO + entry("a.parquet")), "pip install '.[parquet]'")


def test_jigsaws_wants_two_arms_and_bases_that_can_reach(tmp_path):
    pose = np.hstack([[0.0, 0.0, 0.0], np.eye(3).ravel()])
    row = np.zeros(76)
    row[38:50] = row[57:69] = pose
    np.savetxt(tmp_path / "a.txt", np.tile(row, (3, 1)))
    says(manifest(tmp_path, 'arms = ["psm-classic"]\n' + entry("a.txt")), "two slaves", "name two")
    inside = "[[bases]]\nxyz_m = [0, 0, 0.0095]\n" * 2  # the jaw axis on the remote centre: no definite joints
    says(manifest(tmp_path, TWO + entry("a.txt") + inside), "a.txt", "cannot be reached", "bases")
