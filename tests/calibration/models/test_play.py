import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from trocar.calibration.models import PlayModel, TrainingMotion
from trocar.calibration.models import play as module
from trocar.calibration.models.play import fit_wrist, with_spectrum, wrist_features
from trocar.calibration.models.play_map import PlayMap
from trocar.calibration.plant import PSM1_GREY, play_operator
from trocar.calibration.recording import Recording
from trocar.errors import TrocarError
from walks import walk

RADII = np.array([[0.1, 0.2], [0.05, 0.3], [0.2, 0.15]])


@pytest.fixture(scope="module")
def drawn():
    """A model whose numbers are drawn: nothing is small or zero by chance."""
    rng = np.random.default_rng(0)
    fitted = PlayMap(
        linear=rng.normal(0, 0.2, (3, 9)),
        inputs=np.array([0, 1, 2, 3, 5, 7]),
        mean=rng.normal(0, 0.1, 6),
        scale=rng.uniform(0.5, 1.0, 6),
        centres=rng.normal(size=(5, 6)),
        bumps=rng.normal(0, 0.05, (3, 5)),
    )
    training = TrainingMotion(np.full(6, 0.01), np.zeros(6), np.ones(6), 50)
    return PlayModel(0.3, -0.4, RADII, rng.normal(0, 0.1, 6), rng.normal(0, 0.1, (3, 6)), fitted, training)


def seen(q):
    """Return what the operators see along commands (n, 6), by the definition."""
    return np.column_stack([q[:, 3], q[:, 4] + 0.3 * q[:, 5], q[:, 5] - 0.4 * q[:, 4]])


def test_features_are_the_wrist_and_each_joints_slacks_in_turn(drawn):
    q = walk(1, 40)
    slacks = [u - play_operator(u, r) for u, radii in zip(seen(q).T, RADII, strict=True) for r in radii]
    assert_allclose(wrist_features(q, 0.3, -0.4, RADII), np.column_stack([q[:, 3:], *slacks]), atol=1e-12)
    assert_allclose(drawn.inputs(q), seen(q), atol=1e-12)
    assert_allclose(drawn.start(q[0]), np.tile(seen(q)[0][:, None], 2), atol=1e-12)


def test_joints_are_commands_and_errors(drawn):
    q = walk(2, 40)
    expected = q + drawn.offset
    expected[:, :3] += q @ drawn.outer.T
    expected[:, 3:] += drawn.map(wrist_features(q, 0.3, -0.4, RADII))
    assert_allclose(drawn.predict(q), expected, atol=1e-12)
    state = drawn.start(q[0])
    for row, joints in zip(q, expected, strict=True):
        assert_allclose(drawn.linearize(state, row)[0], joints, atol=1e-12)
        found, state = drawn.step(state, row)
        assert_allclose(found, joints, atol=1e-12)
    assert_allclose(drawn.remember(drawn.start(q[0]), q), state, atol=1e-12)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_jacobian_is_the_finite_difference(drawn, seed):
    q, h = walk(seed, 30), 1e-6
    state = drawn.start(q[0])
    for row in q[:-1]:
        _, state = drawn.step(state, row)
    joints, jacobian = drawn.linearize(state, q[-1])
    sides = np.array([[(drawn.step(state, q[-1] + s * d)[0] - joints)[3:] / (s * h) for s in (1, -1)]
                      for d in h * np.eye(6)[3:]])  # fmt: skip
    ahead, behind = sides[:, 0].T, sides[:, 1].T
    smooth = np.abs(ahead - behind) < 1e-4  # at a kink the two sides differ
    assert_allclose(jacobian[smooth], ahead[smooth], atol=2e-4)


def test_slack_follows_within_the_backlash_and_not_at_its_ends(drawn):
    q = np.zeros(6)
    rest = drawn.start(q)
    within, driven = np.zeros(6), np.zeros(6)
    within[3:], driven[3:] = 0.01, 3.0
    for command in (within, driven):
        joints, jacobian = drawn.linearize(rest, command)
        steps = [(drawn.step(rest, command + 1e-6 * d)[0] - joints)[3:] / 1e-6 for d in np.eye(6)[3:]]
        assert_allclose(jacobian, np.transpose(steps), atol=1e-5)
    response = drawn.respond(rest, np.array([q, driven]), drawn.inputs(driven)[None])
    assert_allclose(response.by_command[-1], response.taut[-1])
    assert np.abs(response.by_command[0] - response.taut[0]).max() > 0.1


def test_what_drove_an_operator_last_is_known(drawn):
    """Roll goes up, turns beyond the next command, and comes back within the slack of the wider operator."""
    q = np.zeros((4, 6))
    q[:, 3] = [0.0, 0.5, 0.4, 0.39]
    turns = drawn.inputs(q[:-1]).copy()
    turns[1, 0] = 0.55  # after command 1
    response = drawn.respond(drawn.start(q[0]), q, turns)
    # Widths .1 and .2: from .55 back to .39 the narrow one is dragged within .35 .. .55 no more, the wide one neither.
    assert response.moved[:, 0].tolist() == [[0, 0], [2, 2], [3, 3], [3, 3]]
    back = q.copy()
    back[2:, 3] = [0.3, 0.1]
    response = drawn.respond(drawn.start(q[0]), back, turns)
    assert response.moved[:, 0].tolist() == [[0, 0], [2, 2], [4, 3], [6, 6]]
    assert not response.moved[:, 1:].any()


def straight(model, q):
    """Inputs that turn nowhere between the commands."""
    return model.inputs(q[:-1])


def test_a_response_is_what_step_after_step_gives(drawn):
    q = 3.0 * walk(6, 40)
    state = drawn.start(q[0])
    response = drawn.respond(state, q, straight(drawn, q))
    for row, joints in zip(q, response.joints, strict=True):
        expected, state = drawn.step(state, row)
        assert_allclose(joints, expected, atol=1e-12)
    assert_allclose(response.state, state, atol=1e-12)


def test_a_turn_between_two_commands_leaves_its_slack(drawn):
    q = 3.0 * walk(1, 40)[[0, 30]]
    start, beyond = drawn.start(q[0]), drawn.inputs(q[1]) + 0.05
    over = q[1].copy()
    over[3:] = np.linalg.solve(drawn.mix, beyond)
    three = np.array([q[0], over, q[1]])
    turned, expected = drawn.respond(start, q, beyond[None]), drawn.respond(start, three, straight(drawn, three))
    assert_allclose(turned.joints[-1], expected.joints[-1], atol=1e-12)
    assert np.abs(turned.joints[-1] - drawn.respond(start, q, straight(drawn, q)).joints[-1]).max() > 3e-3


def test_slopes_of_a_response_are_those_of_small_steps(drawn):
    """By a row's own command, and by those that drove an operator last which is in its slack now."""
    rng = np.random.default_rng(2)
    q = np.array([0.85, 0.0, 0.18, -0.3, -0.1, -0.2]) + np.cumsum(rng.normal(size=(25, 6)) * 0.08, axis=0)
    state = drawn.start(q[0]) + rng.uniform(-0.5, 0.5, RADII.shape) * RADII
    response = drawn.respond(state, q, straight(drawn, q))
    later = 0
    for row in range(1, 25):
        for joint in range(3):
            pushed = q.copy()
            pushed[row, 3 + joint] += 1e-6
            moved = drawn.respond(state, pushed, straight(drawn, pushed)).joints
            measured = (moved - response.joints)[:, 3:] / 1e-6
            expected = np.zeros_like(measured)
            expected[row] = response.by_command[row, :, joint]
            for i in range(3):
                driven = (response.moved[:, i] // 2 == row) & (response.moved[:, i] > 0)
                driven[: row + 1] = False
                later += driven.sum()
                expected += np.einsum("nak,nk->na", response.by_operator[:, :, i], driven) * drawn.mix[i, joint]
            assert_allclose(measured, expected, atol=1e-4)
    assert later > 20


def test_the_spectrum_covers_what_is_identified_and_stands_beside_it():
    radii = with_spectrum(np.array([0.03, 0.1, 0.12]))
    assert_allclose(radii[:, 0], [0.03, 0.1, 0.12])
    rest = radii[:, 1:]
    assert (rest == rest[0]).all()
    widths = rest[0]
    assert (np.diff(widths) > 0).all() and widths[0] < 0.018 and widths[-1] > 1.5 * 0.128
    assert (widths[1:] / widths[:-1] < 2.1).all() and (widths[1:] / widths[:-1] > 1.3).all()


def made(error, n=120, valid=None):
    q = walk(5, n) + [0.8, 0.1, 0.2, -0.3, 0.1, 0.2]
    return Recording(q, q + error(q), np.ones(n, bool) if valid is None else valid, np.arange(float(n)))


def test_a_fit_puts_together_plant_map_and_outer_joints(monkeypatch):
    monkeypatch.setattr(module, "fit_plant", lambda recording: PSM1_GREY)
    rng = np.random.default_rng(0)
    recording = made(
        lambda q: 0.02 * q[:, ::-1] + 0.05 + 0.002 * rng.normal(size=q.shape), valid=np.arange(120) % 7 > 0
    )
    model = PlayModel.fit(recording, rng)
    assert (model.a, model.b) == (PSM1_GREY.a, PSM1_GREY.b)
    assert_allclose(model.radii, with_spectrum(PSM1_GREY.radii))
    fitted, constant = fit_wrist(recording, PSM1_GREY.a, PSM1_GREY.b, model.radii)
    assert_allclose(model.map.linear, fitted.linear)
    assert_allclose(model.offset[3:], constant)
    # The outer joints: a ridge regression that ten samples of ordinary size would outweigh.
    q, error = recording.q_cmd[recording.valid], (recording.q_phy - recording.q_cmd)[recording.valid, :3]
    z = (q - q.mean(axis=0)) / q.std(axis=0)
    more = np.vstack([z, np.sqrt(10.0) * np.eye(6)])
    weights = np.linalg.lstsq(more, np.vstack([error - error.mean(axis=0), np.zeros((6, 3))]), rcond=None)[0]
    assert_allclose(q @ model.outer.T + model.offset[:3], error.mean(axis=0) + z @ weights, atol=1e-9)


def test_errors_that_are_linear_in_the_command_are_found_with_their_constant():
    """Commands are not about zero, so the constant is not the mean error."""
    recording = made(lambda q: 0.2 * q[:, [3, 4, 5, 3, 4, 5]] + [0, 0, 0, 0.05, -0.1, 0.2], n=400)
    radii = with_spectrum(PSM1_GREY.radii)
    fitted, constant = fit_wrist(recording, 0.1, 0.1, radii)
    errors = fitted(wrist_features(recording.q_cmd, 0.1, 0.1, radii)) + constant
    assert_allclose(errors, (recording.q_phy - recording.q_cmd)[:, 3:], atol=0.012)


def test_a_constant_error_of_the_wrist_is_found_whole():
    radii = with_spectrum(PSM1_GREY.radii)
    rng = np.random.default_rng(1)
    noise = 0.002 * rng.normal(size=(120, 6))
    one, base = fit_wrist(made(lambda q: noise), 0.1, 0.1, radii)
    other, moved = fit_wrist(made(lambda q: noise + [9.0, 9.0, 9.0, 0.3, -0.2, 0.1]), 0.1, 0.1, radii)
    assert_allclose(moved - base, [0.3, -0.2, 0.1], atol=1e-9)
    assert_allclose(one.linear, other.linear, atol=1e-9)


def test_far_from_the_training_data_the_linear_part_goes_on_alone(fitted):
    model = fitted["play"]
    assert len(model.map.centres)
    features = np.zeros((1, 30))
    features[0, :3] = 50.0
    assert_allclose(model.map(features), features @ model.map.linear.T, atol=1e-12)
    q = walk(5, 60)
    far = q + np.array([0, 0, 0, 4.0, 4.0, 4.0])
    assert np.all(np.abs(model.predict(far) - far)[:, 3:] < 2.0)


def test_negative_radii_are_refused(drawn):
    arrays = drawn.arrays()
    again = PlayModel.from_arrays(arrays, drawn.training)
    assert (again.a, again.b) == (drawn.a, drawn.b)
    for key in ("radii", "offset", "outer"):
        assert np.array_equal(getattr(again, key), getattr(drawn, key))
    PlayModel.from_arrays(arrays | {"radii": np.zeros((3, 2))}, drawn.training)
    wrong = RADII.copy()
    wrong[2, 1] = -1e-9
    with pytest.raises(TrocarError, match="'radii' holds negative ones"):
        PlayModel.from_arrays(arrays | {"radii": wrong}, drawn.training)
    for key, value in (("coupling", np.zeros(3)), ("outer", np.zeros((3, 5))), ("radii", np.zeros((2, 2)))):
        with pytest.raises(TrocarError, match=f"{key!r} has shape"):
            PlayModel.from_arrays(arrays | {key: value}, drawn.training)


def test_it_shows_its_backlash_in_degrees_and_its_coupling(drawn):
    words = "backlash of q4 q5 q6 11.5, 5.7, 22.9 deg, coupling 0.30 and -0.40"
    assert repr(drawn) == f"<cable model 'play', fitted on 50 rows: {words}>"
