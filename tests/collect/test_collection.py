"""Collections in the simulated cell: what images show, what is flagged, what is saved and resumed."""

import numpy as np
import pytest

from simulated import STATION
from trocar.arms import fk
from trocar.calibration.excitation import PSM1_BOX, MotionBox
from trocar.calibration.recording import load_recording
from trocar.collect.chain import calibrated
from trocar.collect.collection import SAMPLE_S, Collection
from trocar.collect.motion import commands_in_view, why_no_images
from trocar.errors import TrocarError
from trocar.lab import SensorFlaws, load_station
from trocar.lab.session import draw_session
from trocar.perception.fiducial_joints import GOOD, NOTHING
from trocar.perception.fiducials import SIX_SPHERES
from trocar.perception.image import Window
from trocar.perception.spheres import find_spheres
from trocar.sim.calibration_cells import FiducialCell

SESSION = draw_session(STATION, np.random.default_rng(1))
ROWS = 40
LOOKED_AT = list(STATION.arms)


def collection(arm="psm1", rows=ROWS, seed=4, session=SESSION, **options):
    box = STATION.arm(arm).calibration
    assert box is not None
    return Collection(session, arm, box, np.random.SeedSequence(seed), rows, **options)


def T_camera_base_true(session, arm):
    return session.T_world_camera["overhead"].inverse() @ session.T_world_base[arm]


def true_centers_m(arm, cell, q_joint):
    """Return where the spheres really are in the camera, with what the printer did."""
    return T_camera_base_true(SESSION, arm).apply(cell.fixture.base_centers_m(STATION.arm(arm).model, q_joint))


@pytest.fixture(scope="module")
def collected(tmp_path_factory):
    """Both arms' collections and what was found in their images."""
    folder = tmp_path_factory.mktemp("collected")
    both = {arm: collection(arm) for arm in LOOKED_AT}
    return {arm: (one, one.run(folder / f"{arm}.npz"), folder / f"{arm}.npz") for arm, one in both.items()}


# What images show.


@pytest.mark.parametrize("arm", LOOKED_AT)
def test_centres_in_flawed_images_are_where_the_spheres_are(collected, arm):
    one, found, _ = collected[arm]
    error = np.linalg.norm(found - true_centers_m(arm, one._cell, one._q_joint), axis=-1)
    seen = np.isfinite(error)
    assert seen[2:].mean() > 0.9 and not seen[:2].any()
    assert np.sqrt(np.mean(error[seen] ** 2)) < 0.12e-3
    assert error[seen].max() < 0.5e-3


def test_a_perfect_camera_shows_them_closer_still():
    one = collection(rows=30, flaws=SensorFlaws.none())
    found = np.array([one.look(row) for row in range(2, 12)])
    error = np.linalg.norm(found - true_centers_m("psm1", one._cell, one._q_joint[2:12]), axis=-1)
    assert np.nanmedian(error) < 0.02e-3


@pytest.mark.parametrize("arm", LOOKED_AT)
def test_distances_and_joints_are_as_good_as_the_papers(collected, arm):
    one, found, _ = collected[arm]
    measured = one.measured(found)
    recording = one.recording(measured)
    error = np.sqrt(np.mean((recording.q_phy - one.q_joint)[recording.valid] ** 2, axis=0))
    assert measured.distance_rms_m <= 0.35e-3
    assert error[[0, 1, 3, 4, 5]].max() <= 0.01 and error[2] < 0.2e-3
    assert recording.valid.mean() > 0.85
    off = np.abs((recording.q_phy - one.q_cmd)[recording.valid, 3])
    assert off.mean() > 10 * error[3]  # it is the cables that were measured, not the commands


@pytest.mark.parametrize("arm", LOOKED_AT)
def test_the_base_is_found_where_the_arm_went(collected, arm):
    """A printer's .1 mm on the shaft's spheres, near the middle of the place, leaves about as much there."""
    one, found, _ = collected[arm]
    off = one.T_camera_base_true.inverse() @ one.measured(found).T_camera_base
    tips = fk(one.view.arm, one.q_cmd[2:]).translation_m
    assert np.linalg.norm(off.apply(tips) - tips, axis=-1).max() < 0.4e-3


def test_a_sphere_behind_another_is_not_reported(collected):
    """The wrist is bent until the jaw's spheres stand behind each other and behind the shaft."""
    one, _, _ = collected["psm1"]
    cell = FiducialCell(SESSION, "psm1", "overhead", SIX_SPHERES, np.random.default_rng(0))
    rng, hidden = np.random.default_rng(8), 0
    size = np.array([one.view.lens.width, one.view.lens.height])
    for q in rng.uniform(PSM1_BOX.lower, PSM1_BOX.upper, (25, 6)):
        around = one.view.bounds_px(q)
        first, last = (corner.clip(0, size).astype(int) for corner in around)
        found = find_spheres(cell.image(q, Window(tuple(first), tuple(last - first)), rng), SIX_SPHERES)
        error = np.linalg.norm(found - true_centers_m("psm1", cell, q), axis=-1)
        hidden += int(np.isnan(error).sum())
        assert not (error > 1e-3).any()
    assert hidden >= 5


def test_a_rectangle_of_the_image_is_what_the_whole_one_shows_there():
    cell = FiducialCell(SESSION, "psm1", "overhead", SIX_SPHERES, np.random.default_rng(0), SensorFlaws.none())
    q, lens = PSM1_BOX.lower + 0.4 * (PSM1_BOX.upper - PSM1_BOX.lower), STATION.cameras["overhead"].model
    whole = cell.image(q, Window((0, 0), (lens.width, lens.height)), np.random.default_rng(0))
    part = cell.image(q, Window((200, 40), (450, 350)), np.random.default_rng(0))
    np.testing.assert_array_equal(part.color, whole.color[40:390, 200:650])
    np.testing.assert_array_equal(part.depth_m, whole.depth_m[40:390, 200:650])
    both = [find_spheres(image, SIX_SPHERES) for image in (whole, part)]
    assert np.isfinite(both[1]).all(-1).sum() >= 4
    np.testing.assert_allclose(*both, atol=0.03e-3)
    with pytest.raises(TrocarError, match=r"250 x 200 pixels at \(800, 100\) leaves the image"):
        cell.image(q, Window((800, 100), (250, 200)), np.random.default_rng(0))


@pytest.mark.parametrize("arm", LOOKED_AT)
def test_joints_put_the_tip_where_it_is_though_the_base_is_registered_wrongly(arm):
    """As in a cell as hard as recordings show, whose bases are off by most of a millimetre, and its wrists by .2 mm."""
    session = draw_session(load_station("peg-transfer"), np.random.default_rng(6))
    one = collection(arm, seed=7, session=session)
    cell = FiducialCell(session, arm, "overhead", SIX_SPHERES, np.random.default_rng(0))  # its spheres are displaced
    base = T_camera_base_true(session, arm)
    p = base.apply(cell.fixture.base_centers_m(session.models[arm], one._q_joint))
    recording = one.recording(one.measured(p + 0.06e-3 * np.random.default_rng(1).standard_normal(p.shape)))
    assert recording.valid.all()
    true, model = (base @ fk(session.models[arm], one._q_joint)).translation_m, one.view.arm
    for q, limit_m in ((recording.q_phy, 0.1e-3), (one.q_joint, 1e-9)):
        missed = np.linalg.norm((one.view.T_camera_base @ fk(model, q)).translation_m - true, axis=-1)
        assert np.sqrt(np.mean(missed**2)) < limit_m
    as_known = (one.view.T_camera_base @ fk(model, one._q_joint)).translation_m
    assert np.linalg.norm(as_known - true, axis=-1).mean() > 0.3e-3


# Commands.


@pytest.mark.parametrize("arm", LOOKED_AT)
def test_commands_are_dense_within_limits_and_in_view_and_take_no_longer_than_the_papers(arm):
    one = collection(arm, rows=1355)
    model, path = one.view.arm, one.q_cmd[2:]
    assert path.shape == (1355, 6)
    assert (path >= model.lower).all() and (path <= model.upper).all()
    assert one.view.holds(path).all()
    assert one.t_s[-1] <= 18 * 60
    steps = np.abs(np.diff(path, axis=0))
    assert steps.mean(axis=0)[3:].max() < 0.1
    assert (steps.max(axis=0) < STATION.arm(arm).limits.velocity * SAMPLE_S / 4).all()
    box = STATION.arm(arm).calibration
    np.testing.assert_allclose(np.ptp(path, axis=0)[3:], (box.upper - box.lower)[3:])


def test_an_image_may_be_taken_after_every_second_row_only(collected, monkeypatch):
    """The others are commands without a measurement, which the cables feel all the same."""
    looked, found = [], collected["psm1"][1]
    monkeypatch.setattr(Collection, "look", lambda self, row: looked.append(row) or found[row])
    one = collection(every=2)
    seen = one.run()
    assert looked == list(range(2, ROWS + 2, 2))
    np.testing.assert_array_equal(seen[looked], found[looked])
    np.testing.assert_array_equal(one.q_joint, collected["psm1"][0].q_joint)
    recording = one.recording(one.measured(seen))
    assert not recording.valid[3::2].any() and recording.valid[2::2].mean() > 0.8
    assert one.digest != collected["psm1"][0].digest


def test_fewer_rows_are_the_first_of_more():
    np.testing.assert_array_equal(collection(rows=60).q_cmd, collection(rows=200).q_cmd[:62])


def test_a_range_that_the_camera_does_not_see_is_refused():
    away = MotionBox(PSM1_BOX.lower - [1.5, 0, 0, 0, 0, 0], PSM1_BOX.upper - [1.5, 0, 0, 0, 0, 0], PSM1_BOX.step)
    one = collection()
    with pytest.raises(TrocarError, match="camera does not see the spheres of 'psm-classic'"):
        commands_in_view(one.view, away, ROWS, np.random.SeedSequence(0), wide=False)
    assert "does not see" in why_no_images(STATION, "psm1", away)


def test_arms_and_stations_that_cannot_be_looked_at_say_why():
    assert why_no_images(STATION, "psm1", PSM1_BOX) == ""
    assert "on a PSM only" in why_no_images(load_station("raven-pair"), "left", PSM1_BOX)
    with pytest.raises(TrocarError, match="29 rows is too small to fit on; give 30 or more"):
        collection(rows=29)


# What is kept.


def test_an_interrupted_collection_goes_on_and_leaves_the_same_bytes(collected, tmp_path, monkeypatch):
    """Thirty rows of the same motion: what was seen before the interruption is not looked at again."""
    found, calls, looked = collected["psm1"][1], [], []

    def stop(done, total):
        calls.append((done, total))
        if done == 30:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:  # these images were taken before, by the longer collection
        patched.setattr(Collection, "look", lambda self, row: found[row])
        collection(rows=30).run(tmp_path / "whole.npz")
        with pytest.raises(KeyboardInterrupt):
            collection(rows=30).run(tmp_path / "again.npz", stop)
    assert (tmp_path / "again.npz").read_bytes() != (tmp_path / "whole.npz").read_bytes()
    look = Collection.look
    monkeypatch.setattr(Collection, "look", lambda self, row: looked.append(row) or look(self, row))
    again = collection(rows=30).run(tmp_path / "again.npz", lambda done, total: calls.append((done, total)))
    assert calls[30][0] == 27 and calls[-1] == (32, 32)  # saved after 26 rows, went on with the next
    assert looked == [26, 27, 28, 29, 30, 31]
    np.testing.assert_array_equal(again, found[:32])
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()
    before = len(calls)
    collection(rows=30).run(tmp_path / "again.npz", lambda done, total: calls.append((done, total)))
    assert len(calls) == before and len(looked) == 6


def test_centres_of_another_collection_are_refused(collected):
    _, _, path = collected["psm1"]
    with pytest.raises(TrocarError, match=r"psm1\.npz' is of another collection; move it away"):
        collection(seed=5).run(path)
    with pytest.raises(TrocarError, match="of another collection"):
        collection(rows=ROWS + 1).run(path)


def test_a_recording_from_images_is_read_like_any_other(collected, tmp_path):
    one, _, path = collected["psm2"]
    result = calibrated(one, one.run(path), tmp_path, model="offset", rng=np.random.default_rng(0))
    recording = load_recording(tmp_path / "recording_psm2.npz")
    np.testing.assert_array_equal(recording.q_cmd, one.q_cmd)
    np.testing.assert_array_equal(recording.valid, result.recording.valid)
    assert not recording.valid[:2].any()
    assert result.measured.flags[:2] == (NOTHING, NOTHING) and result.measured.flags[2] == GOOD
    assert result.evaluation is not None and result.fitted_rows == int(0.8 * (ROWS + 2))
    assert (np.flatnonzero(result.evaluation.recording.valid) >= result.fitted_rows).all()
