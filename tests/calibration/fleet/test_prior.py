import numpy as np
import pytest
from numpy.testing import assert_allclose

from fleets import fleet
from trocar.calibration.fleet import learn_prior, load_prior
from trocar.calibration.fleet.prior import COMMON, FEATURES, FORMAT, VERSION, FleetPrior, LoopFit
from trocar.errors import TrocarError
from trocar.files.archive import Archive, read_archive


def one(name="a", shape=0.0, weights=0.0, outer=0.0, left=1.0):
    """Return a fit whose numbers are all the same, or given."""
    values = {"shape": (5, shape), "weights": ((3, FEATURES), weights), "outer": ((3, 7), outer), "left": (6, left)}
    return LoopFit(name, **{key: np.ones(n) * value for key, (n, value) in values.items()})


def least_sd(joint):
    """Return the least SDs of a joint's weights, as the docs tell them: rad, and rad per rad."""
    sd = np.full(FEATURES, 0.06 / np.sqrt(3))
    sd[0], sd[1:4] = 0.15, 0.03
    sd[1 + joint] = (0.02, 0.05, 0.10)[joint]
    return sd


def covariances(prior):
    return prior.factors @ prior.factors.transpose(0, 2, 1)


def test_the_prior_is_about_the_mean_of_its_recordings():
    rng = np.random.default_rng(0)
    fits = [one(str(k), rng.normal(size=5), rng.normal(size=(3, FEATURES)), 1.0, 1.0) for k in range(3)]
    prior = FleetPrior.of(fits)
    assert_allclose(prior.shape_mean, np.mean([fit.shape for fit in fits], axis=0))
    assert_allclose(prior.weights, np.mean([fit.weights for fit in fits], axis=0))
    assert prior.sources == ("0", "1", "2")


def test_the_next_instrument_is_as_far_off_as_those_that_were_seen_and_their_mean_together():
    """Of n instruments with variance v the next one is v (1 + 1 / n) about their mean."""
    rng = np.random.default_rng(1)
    fits = [one(str(k), 2.0 * rng.normal(size=5), 2.0 * rng.normal(size=(3, FEATURES))) for k in range(5)]
    prior = FleetPrior.of(fits)
    shapes, weights = np.array([fit.shape for fit in fits]), np.array([fit.weights for fit in fits])
    assert_allclose(prior.shape_sd, np.sqrt(1.2 * np.var(shapes, axis=0, ddof=1)))
    for joint in range(3):
        least = COMMON * np.diag(least_sd(joint) ** 2)
        assert_allclose(covariances(prior)[joint], 1.2 * np.cov(weights[:, joint].T) + least, rtol=1e-9)


def test_alike_instruments_leave_room_for_others():
    prior = FleetPrior.of([one("a"), one("b")])
    assert_allclose(prior.shape_sd, [0.4, 0.4, 0.4, 0.06, 0.06])
    for joint in range(3):
        sd = np.sqrt(np.diag(covariances(prior)[joint]))
        assert_allclose(sd, np.sqrt(0.5) * least_sd(joint))
    assert_allclose(prior.outer_sd[:, 0], [3e-3, 3e-3, 5e-4])
    assert_allclose(prior.outer_sd[:, 1:], 0.0)


def test_outer_maps_scatter_about_none_but_their_constants_about_their_mean():
    columns = np.arange(1.0, 8.0)
    prior = FleetPrior.of([one("a", outer=columns), one("b", outer=3.0 * columns), one("c", outer=2.0 * columns)])
    assert_allclose(prior.outer_sd[:, 1:], np.tile(np.sqrt(14.0 / 3) * columns[1:], (3, 1)))
    assert_allclose(prior.outer_sd[:, 0], np.sqrt(2.0 / 3))


def test_noise_is_that_of_the_middle_recording():
    left = np.array([1.0, 4.0, 9.0, 16.0, 25.0, 36.0])
    prior = FleetPrior.of([one("a", left=left), one("b", left=100 * left), one("c", left=0.01 * left)])
    assert_allclose(prior.outer_noise_sd, [1.0, 2.0, 3.0])
    assert_allclose(prior.noise_sd, [4.0, 5.0, 6.0])


def test_two_recordings_are_the_least_fleet():
    assert FleetPrior.of([one("a"), one("b", 1.0)]).sources == ("a", "b")
    with pytest.raises(TrocarError, match="from 1 recordings; give two or more"):
        FleetPrior.of([one("a")])
    with pytest.raises(TrocarError, match="two or more"):
        learn_prior([])


def test_a_prior_can_leave_an_instrument_out():
    built_in = load_prior("fleet")
    left = built_in.without("psm1_grey")
    assert left.sources == ("psm1_red_user_random", "psm2_grey_random", "psm1_new_random")
    assert np.abs(left.shape_mean - built_in.shape_mean).max() > 0.05
    with pytest.raises(TrocarError, match="from 1 recordings"):
        left.without("psm2").without("psm1_new")


def test_a_prior_is_kept_in_a_file(tmp_path):
    prior = fleet()
    again = load_prior(prior.save(tmp_path / "prior.npz"))
    assert again.sources == prior.sources
    for key in ("shape_mean", "shape_sd", "weights", "factors", "noise_sd", "outer_sd", "outer_noise_sd"):
        assert_allclose(getattr(again, key), getattr(prior, key))
    with pytest.raises(TrocarError, match=r"must end in .npz"):
        prior.save(tmp_path / "prior.txt")


@pytest.mark.parametrize(
    ("header", "arrays", "words"),
    [
        ({"sources": "abcd"}, {}, "does not say what it was learned from"),
        ({"sources": ["a", "b", "c", 4]}, {}, "does not say what it was learned from"),
        ({"sources": ["a", "b", "c"]}, {}, "names 3 recordings and has fits to 4"),
        ({}, {"left": np.tile([1.0, 1.0, 1.0, 1.0, 1.0, 0.0], (4, 1))}, "not variances"),
        ({}, {"shape": np.zeros((4, 6))}, "'shape' has shape"),
        ({}, {"weights": np.zeros((4, 3, FEATURES + 1))}, "'weights' has shape"),
        ({}, {"outer": np.zeros((4, 2, 7))}, "'outer' has shape"),
        ({}, {"left": np.ones((4, 7))}, "'left' has shape"),
        ({}, {"left": np.ones((3, 6))}, "'left' has shape"),
    ],
)
def test_a_damaged_prior_is_one_sentence(tmp_path, header, arrays, words):
    path = fleet().save(tmp_path / "prior.npz")
    was = read_archive(path, FORMAT, VERSION)
    path.unlink()
    Archive(was.header | header, {**was.arrays, **arrays}).save(path)
    with pytest.raises(TrocarError, match=f"is damaged: .*{words}.*; learn it again"):
        load_prior(path)


def test_a_file_that_is_no_prior_is_refused(tmp_path):
    with pytest.raises(TrocarError, match="does not exist"):
        load_prior(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"nonsense")
    with pytest.raises(TrocarError):
        load_prior(tmp_path / "bad.npz")
