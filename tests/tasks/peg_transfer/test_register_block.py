import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from typer.testing import CliRunner

from trocar.cli import app
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.register_block import fit_cloud
from trocar.tasks.peg_transfer.shapes import Block


def difference(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Distance in mm, and yaw in deg modulo 120, of two poses in m."""
    turn = a[:3, :3].T @ b[:3, :3]
    yaw = np.degrees(np.arctan2(turn[1, 0], turn[0, 0]))
    return 1e3 * float(np.linalg.norm(a[:3, 3] - b[:3, 3])), abs((yaw + 60) % 120 - 60)


def icp(points: np.ndarray, model: np.ndarray, T: np.ndarray, steps: int) -> tuple[np.ndarray, float]:
    """Plain point-to-point ICP; the reference that the fit must agree with."""
    tree, rms = cKDTree(model), np.inf
    for _ in range(steps):
        distance, index = tree.query((points - T[:3, 3]) @ T[:3, :3])
        if rms - np.sqrt(np.mean(distance**2)) < 1e-9:
            break
        rms = np.sqrt(np.mean(distance**2))
        a, b = model[index].mean(0), points.mean(0)
        U, _, Vt = np.linalg.svd((model[index] - a).T @ (points - b))
        R = Vt.T @ np.diag([1, 1, np.linalg.det(Vt.T @ U.T)]) @ U.T
        T = SE3.from_parts(SO3(R), b - R @ a).matrix
    return T, float(rms)


def test_agrees_with_a_full_search_on_the_real_capture(recordings):
    data = np.load(recordings / "dvrk" / "blocks" / "capture.npz")
    points, model = data["points_mm"] * 1e-3, data["block_top_model_mm"] * 1e-3
    middle = points.mean(0)
    vectors = np.linalg.svd(points - middle, full_matrices=False)[2]
    z = vectors[2] * np.sign(vectors[2] @ middle)
    R = SO3(np.column_stack([vectors[0], np.cross(z, vectors[0]), z]))
    ends = []
    for yaw in np.radians(np.arange(0, 120, 20)):
        for tilt in (-0.15, 0.15):
            for x in (-2e-3, 2e-3):
                for y in (-2e-3, 2e-3):
                    start = SE3.from_parts(R @ SO3.axis("z", yaw) @ SO3.axis("x", tilt), middle + R.apply([x, y, 0]))
                    ends.append(icp(points[::3], model, start.matrix, 40))
    reference, _ = icp(points, model, min(ends, key=lambda end: end[1])[0], 200)
    fit = fit_cloud(points, Block())
    assert fit.found
    distance_mm, yaw_deg = difference(reference, fit.T_capture_block.matrix)
    assert distance_mm < 0.3 and yaw_deg < 5


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_recovers_any_pose_from_a_noisy_half_seen_face(seed):
    rng = np.random.default_rng(seed)
    face = Block().top_face_m(0.35e-3)
    face = face[face @ SO3.axis("z", rng.uniform(0, 6.28)).matrix[0] > -5e-3]  # one side is hidden
    tilt = SO3.exp([*rng.uniform(-0.6, 0.6, 2), 0]) @ SO3.axis("z", rng.uniform(0, 6.28))
    T = SE3.from_parts(tilt, [*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.4, 0.7)])
    fit = fit_cloud(T.apply(face) + rng.normal(0, 0.15e-3, face.shape), Block())
    assert fit.found
    distance_mm, yaw_deg = difference(T.matrix, fit.T_capture_block.matrix)
    assert distance_mm < 0.5 and yaw_deg < 5


def test_a_plain_disc_is_no_block():
    rng = np.random.default_rng(0)
    disc = rng.uniform(-12e-3, 12e-3, (3000, 2))
    disc = disc[np.linalg.norm(disc, axis=-1) < 12e-3]
    assert not fit_cloud(np.column_stack([disc, np.full(len(disc), 0.6)]), Block()).found


def test_points_all_over_the_place_are_no_block():
    points = np.random.default_rng(0).uniform(-0.03, 0.03, (300, 3)) + [0.0, 0.0, 0.5]
    fit = fit_cloud(points, Block())
    assert not fit.found and fit.reason == "the points form no plane" and fit.T_capture_block is None
    assert fit.inliers < 60 and fit.covered == 0.0


@pytest.mark.parametrize(
    ("points", "message"),
    [(np.zeros((100, 2)), "shape"), (np.zeros((5, 3)), "at least 60"), (np.full((100, 3), np.nan), "NaN")],
)
def test_refuses_bad_points(points, message):
    with pytest.raises(TrocarError, match=message):
        fit_cloud(points, Block())


def test_command_prints_one_json_object(recordings):
    capture = recordings / "dvrk" / "blocks" / "capture.npz"
    result = CliRunner().invoke(app, ["register", "block", str(capture), "--unit", "mm", "--json"])
    assert result.exit_code == 0
    answer = json.loads(result.stdout)
    assert answer["found"] and np.shape(answer["T_capture_block"]) == (4, 4)
    assert {"rms_m", "compute_ms"} <= set(answer)


@pytest.mark.parametrize("yaw_deg", [10.0, 37.0, 64.0, 100.0])
@pytest.mark.parametrize("off_m", [(5e-3, -3e-3), (-20e-3, 12e-3)])
def test_a_clean_face_is_found_where_it_lies_seen_from_above(yaw_deg, off_m):
    """The camera looks down its z, so the face's z points away from it."""
    T = SE3.from_parts(SO3.axis("z", np.radians(yaw_deg)), [*off_m, 0.5])
    fit = fit_cloud(T.apply(Block().top_face_m()), Block())
    distance_mm, yaw_off_deg = difference(T.matrix, fit.T_capture_block.matrix)
    assert fit.found and distance_mm < 0.1 and yaw_off_deg < 0.5 and fit.covered > 0.9
    np.testing.assert_allclose(fit.T_capture_block.matrix[:3, 2], [0, 0, 1], atol=1e-6)
