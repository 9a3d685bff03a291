import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.debridement.pose import PosePairs, read_pairs
from trocar.tasks.debridement.pose.pairs import POSE_COLUMNS

COLUMNS = ["t_detected_s", *(f"{source}_{name}" for source in ("detected", "kinematic") for name in POSE_COLUMNS)]


def write(path, rows, columns=COLUMNS):
    lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_angles_turn_about_fixed_axes_roll_first(tmp_path):
    rows = [[0.5, 0.1, 0.2, 0.3, 90, 0, 90, 0, 0, 0, 0, 0, 0]]
    pairs = read_pairs(write(tmp_path / "pairs.csv", rows))
    assert pairs.times_s.tolist() == [0.5]
    # Roll takes y to z, where yaw leaves it; yaw takes x to y.
    assert np.allclose(pairs.T_base_detected[0].apply(np.eye(3)) - [0.1, 0.2, 0.3], [[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    assert np.allclose(pairs.T_base_kinematic[0].matrix, np.eye(4))


def test_pairs_of_one_moment_become_their_mean_with_a_note(tmp_path):
    rows = [[t, x, 0, 0, yaw, 0, 0, 0, x, 0, 0, 0, 0] for t, x, yaw in [(0, 5, 7), (1, 1, 10), (1, 3, 30), (2, 9, 0)]]
    pairs = read_pairs(write(tmp_path / "pairs.csv", rows))
    assert pairs.times_s.tolist() == [0, 1, 2]
    assert pairs.note == "1 pair of 4 repeated the time of the one before: merged"
    assert np.allclose(pairs.T_base_detected.translation_m[:, 0], [5, 2, 9])
    assert np.allclose(pairs.T_base_kinematic.translation_m[:, 1], [5, 2, 9])
    yaw = SO3.axis("z", np.radians([7.0, 20.0, 0.0]))
    assert np.allclose(pairs.T_base_detected.rotation.matrix, yaw.matrix)
    assert read_pairs(write(tmp_path / "pairs.csv", rows[1:2])).note == ""


@pytest.mark.parametrize(
    ("rows", "columns", "said"),
    [
        ([], COLUMNS, "holds no pose pairs"),
        ([[0] * 12], COLUMNS[:-1], "lacks the columns kinematic_roll_deg"),
        ([[0] * 12 + ["nan"]], COLUMNS, "'nan' as kinematic_roll_deg of pair 0"),
        ([[0] * 12 + ["x"]], COLUMNS, "'x' as kinematic_roll_deg of pair 0, not a finite number"),
        ([[0] * 12], COLUMNS, "None as kinematic_roll_deg of pair 0"),
        ([[1] * 13, [0] * 13], COLUMNS, "must increase, but pair 1 at 0.0 s"),
    ],
)
def test_a_bad_file_is_refused_in_a_sentence(tmp_path, rows, columns, said):
    with pytest.raises(TrocarError, match=said):
        read_pairs(write(tmp_path / "pairs.csv", rows, columns))


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(TrocarError, match="cannot be read"):
        read_pairs(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("times_s", "poses", "said"),
    [
        ([], 0, "n >= 1"),
        ([0.0, np.nan], 2, "time of pair 1 is not finite"),
        ([0.0, 1.0], 3, r"shape \(3, 4, 4\); give one pose per time, \(2, 4, 4\)"),
    ],
)
def test_pairs_check_what_they_are_made_of(times_s, poses, said):
    T = SE3.identity((poses,))
    with pytest.raises(TrocarError, match=said):
        PosePairs(np.array(times_s), T, T)


def test_poses_must_be_finite():
    broken = SE3.unchecked(np.array([np.eye(4), np.full((4, 4), np.nan)]))
    with pytest.raises(TrocarError, match="T_base_detected of pair 1 is not finite"):
        PosePairs(np.array([0.0, 1.0]), broken, SE3.identity((2,)))
