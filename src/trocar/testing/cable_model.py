"""What every cable model has to do."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.models import MODELS, CableModel, load_model, save_model
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import Recording
from trocar.errors import InvalidInput
from trocar.testing.requirement import CheckFailed, require

ROWS = 200
STEP = (0.003, 0.005, 0.0007, 0.03, 0.02, 0.025)
"""Standard deviation of a joint's acceleration in the walk, rad and m per sample squared."""


def check_cable_model(
    kind: str | type[CableModel], fitted: CableModel | None = None, *, tolerance: float = 1e-9
) -> None:
    """Check a cable model on a synthetic recording of 200 samples of a da Vinci arm with play in its cables.

    Args:
        kind: the class, or its registered name.
        fitted: a fitted model of this kind, if fitting takes long; None: one is fitted here.
        tolerance: allowed difference of step-by-step from whole-history predictions, rad and m.

    Raises:
        CheckFailed: the model breaks a requirement; the message says which.
    """
    made = MODELS.pick(kind) if isinstance(kind, str) else kind
    subject, q = f"cable model {made.name!r}", _walk(0, ROWS)
    recording = _recording(q, np.ones(ROWS, bool))
    model = made.fit(recording, np.random.default_rng(1)) if fitted is None else fitted
    require(model.name == made.name, subject, f"keep its name when fitted, not {model.name!r}")
    _check_steps(model, subject, tolerance)
    _check_density(model, subject)
    shift = np.linspace(-0.1, 0.1, 6)
    moved = model.shifted(shift).predict(q) - model.predict(q)
    require(np.allclose(moved, shift, atol=1e-12), subject, "add to every prediction what it is shifted by")
    _check_file(made, model, subject)
    _check_short(made, subject)
    if fitted is None:
        _check_invalid_rows(made, model, subject)


def _check_steps(model: CableModel, subject: str, tolerance: float) -> None:
    q = _walk(3, 60)
    whole, state, steps = model.predict(q), model.start(q[0]), []
    require(whole.shape == q.shape, subject, f"predict six joints for every command, not shape {whole.shape}")
    for row in q:
        joints, state = model.step(state, row)
        steps.append(joints)
    off = float(np.abs(np.array(steps) - whole).max())
    require(off <= tolerance, subject, f"say step by step what it says of the whole history, not {off:.2g} off")
    beyond = 3.0 * q[5] - 2.0 * q[-1]  # from there q[5] is approached from the other side, so memory shows
    first, _, again = (model.step(state, command)[0] for command in (q[5], beyond, q[5]))
    pure = np.array_equal(first, again)
    require(pure, subject, "leave a state as it was: a controller tries several commands from it")


def _check_density(model: CableModel, subject: str) -> None:
    q = _walk(3, 30)
    halves = np.arange(0, 29.5, 0.5)
    dense = np.column_stack([np.interp(halves, np.arange(30), joint) for joint in q.T])
    independent = float(np.abs(model.predict(dense)[::2] - model.predict(q)).max()) < 1e-9
    require(
        independent == model.rate_independent,
        subject,
        f"have rate_independent = {independent}: it {'does not matter' if independent else 'matters'} here how "
        "densely a path is sampled",
    )


def _check_file(kind: type[CableModel], model: CableModel, subject: str) -> None:
    q, unregistered = _walk(4, 60), kind.name not in MODELS
    if unregistered:
        MODELS.register(kind.name, kind)
    try:
        with tempfile.TemporaryDirectory() as folder:
            loaded = load_model(save_model(model, Path(folder) / "model.npz"))
    finally:
        if unregistered:
            MODELS.forget(kind.name)
    off = float(np.abs(loaded.predict(q) - model.predict(q)).max())
    require(off <= 1e-12, subject, f"come back from its file as it was, not {off:.2g} off")
    for key in ("interval", "lower", "upper", "rows"):
        same = np.allclose(getattr(loaded.training, key), getattr(model.training, key))
        require(same, subject, f"keep {key} of its training motion in its file")


def _check_short(kind: type[CableModel], subject: str) -> None:
    try:
        kind.fit(_recording(_walk(0, 20), np.ones(20, bool)), np.random.default_rng(0))
    except InvalidInput:
        return
    raise CheckFailed(f"{subject} must: refuse a recording of 20 samples (TrainingMotion.of does)")


def _check_invalid_rows(kind: type[CableModel], model: CableModel, subject: str) -> None:
    """Check that a fit ignores what invalid rows contain, and depends on the others."""
    q = _walk(0, ROWS)
    valid = np.ones(ROWS, bool)
    valid[50:60] = False
    masked, spoiled = (
        kind.fit(_recording(q, valid, spoilt), np.random.default_rng(1)).predict(_walk(4, 20))
        for spoilt in (None, slice(50, 60))
    )
    require(np.array_equal(masked, spoiled), subject, "leave aside in a fit the rows that are marked as invalid")
    changed = float(np.abs(masked - model.predict(_walk(4, 20))).max())
    require(changed > 1e-5, subject, "be fitted to the rows of its recording")


def _recording(q: NDArray[np.float64], valid: NDArray[np.bool_], spoilt: Any = None) -> Recording:
    joints = PSM1_GREY.measure(PSM1_GREY.run(q), np.random.default_rng(0))
    if spoilt is not None:
        joints[spoilt] = 7.0
    return Recording(q, joints, valid, np.arange(float(len(q))))


def _walk(seed: int, rows: int) -> NDArray[np.float64]:
    """Return commands (rows, 6) of joints that gather speed and lose it again, rad and m."""
    steps = np.random.default_rng(seed).normal(0, STEP, (rows, 6))
    return np.clip(np.cumsum(np.cumsum(steps, axis=0) * 0.3, axis=0), -1, 1)
