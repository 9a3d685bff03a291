"""Play operators, and the cable transmission made of them, as identified from recordings of real arms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from trocar.calibration.recording import Recording
from trocar.errors import InvalidInput
from trocar.geometry.arrays import Array, finite

WRIST = slice(3, 6)  # the joints q4 q5 q6 (roll, pitch, yaw) whose cables run through the shaft
PlayState = tuple[float, float, float]
"""Outputs of the three play operators (roll, pitch, yaw) in rad: the whole memory of a plant."""

FEW = 4  # for up to this many operators, a loop over plain floats is ten times faster than one over small arrays
_SHAPES = {"radii": (3,), "offset": (3,), "K": (3, 3), "C": (3, 3), "noise_sd": (6,)}


def play_operator(u: ArrayLike, radii: ArrayLike, start: ArrayLike | None = None) -> Array:
    """Return the output of a play operator, ``P_t = clip(P_{t-1}, u_t - r, u_t + r)``: an exact model of backlash.

    The slack ``u - P`` lies in [-r, r]. It depends on past reversals, not on the rate.

    Args:
        u: (n, ...) inputs over time, in rad.
        radii: half-widths r of the backlash in rad; inputs (n, 3, 1) and radii (3, 4) give outputs (n, 3, 4).
        start: state P before the first sample; None starts without slack.

    Raises:
        InvalidInput: a radius is negative or the inputs are not finite.
    """
    u, r = finite("the inputs of a play operator", u, ...), np.asarray(radii, dtype=np.float64)
    if not np.all(r >= 0):
        raise InvalidInput("the radii of a play operator", f"are {r}", "give 0 or more")
    low, high = u - r, u + r
    out = np.empty_like(low)
    if not len(u):
        return out
    state: Array = np.broadcast_to(u[0] if start is None else np.asarray(start), low.shape[1:])
    if state.size <= FEW:
        for index in np.ndindex(*state.shape):
            column = (slice(None), *index)
            p = float(state[index])
            values = []
            for floor, ceiling in zip(low[column].tolist(), high[column].tolist(), strict=True):
                if p < floor:
                    p = floor
                elif p > ceiling:
                    p = ceiling
                values.append(p)
            out[column] = values
        return out
    for row, floor, ceiling in zip(out, low, high, strict=True):
        np.maximum(state, floor, out=row)
        np.minimum(row, ceiling, out=row)
        state = row
    return out


@dataclass(frozen=True, eq=False)
class CablePlant:
    """Hysteresis, coupling and offset of one instrument's cables; deterministic and rate-independent.

    ``q_joint = q_cmd + [0, e]`` with ``e = offset + K [q4 q5 q6] + C s``, where s are the slacks ``u - P(u)`` of play
    operators on ``u = [q4, q5 + a q6, q6 + b q5]``. The outer joints q1 q2 q3 are assumed to be exact.
    """

    radii: Array  # (3,) half-width of the backlash of roll, pitch, yaw in rad
    a: float  # share of yaw in the motion of the pitch cable
    b: float  # share of pitch in the motion of the yaw cable
    offset: Array  # (3,) constant error of q4 q5 q6 in rad; it changes from session to session
    K: Array  # (3, 3) error per rad of command (elastic coupling); rows are the joints in error
    C: Array  # (3, 3) error per rad of slack
    noise_sd: Array  # (6,) SD of measurements of the six joints by fiducials, rad and m (q3)
    source: str  # origin of the values

    def __post_init__(self) -> None:
        for name, shape in _SHAPES.items():
            value = finite(f"a cable plant's {name}", getattr(self, name), *shape).copy()
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if np.any(self.radii < 0) or np.any(self.noise_sd < 0):
            raise InvalidInput("a cable plant", "has a radius or a noise SD below 0", "give 0 or more")
        object.__setattr__(self, "_r", tuple(self.radii.tolist()))
        rows = np.column_stack([self.offset, self.K, self.C]).tolist()
        object.__setattr__(self, "_rows", tuple(map(tuple, rows)))

    def with_offset(self, offset: ArrayLike) -> CablePlant:
        """Return the same cables with another session's offset (3,) of q4 q5 q6, in rad."""
        return replace(self, offset=np.asarray(offset, dtype=np.float64))

    def inputs(self, q_cmd: Array) -> Array:
        """Return the inputs of the play operators, ``[q4, q5 + a q6, q6 + b q5]``; (..., 6) -> (..., 3)."""
        q4, q5, q6 = q_cmd[..., 3], q_cmd[..., 4], q_cmd[..., 5]
        return np.stack([q4, q5 + self.a * q6, q6 + self.b * q5], axis=-1)

    def start(self, q_cmd: ArrayLike) -> PlayState:
        """Return the state of a transmission that rests without slack at this command (6,)."""
        u4, u5, u6 = self.inputs(np.asarray(q_cmd, dtype=np.float64)).tolist()
        return (u4, u5, u6)

    def step(self, state: PlayState, q_cmd: Array) -> tuple[Array, PlayState]:
        """Return the joints (6,) after the command (6,), and the new state; takes a few microseconds."""
        # plain floats: NumPy's overhead on three numbers would dominate
        q1, q2, q3, q4, q5, q6 = q_cmd.tolist()
        (r4, r5, r6), rows = self._r, self._rows  # type: ignore[attr-defined]
        u5, u6 = q5 + self.a * q6, q6 + self.b * q5
        p4, p5, p6 = state
        p4 = max(q4 - r4, min(q4 + r4, p4))
        p5 = max(u5 - r5, min(u5 + r5, p5))
        p6 = max(u6 - r6, min(u6 + r6, p6))
        s4, s5, s6 = q4 - p4, u5 - p5, u6 - p6
        e4, e5, e6 = (
            o + k4 * q4 + k5 * q5 + k6 * q6 + c4 * s4 + c5 * s5 + c6 * s6 for o, k4, k5, k6, c4, c5, c6 in rows
        )
        return np.array([q1, q2, q3, q4 + e4, q5 + e5, q6 + e6]), (p4, p5, p6)

    def run(self, q_cmd: ArrayLike) -> Array:
        """Return the joints (n, 6) for a sequence of commands (n, 6) that starts without slack."""
        q = finite("a plant's commands", q_cmd, "n", 6)
        u = self.inputs(q)
        slack = u - play_operator(u, self.radii)
        joints = q.copy()
        joints[:, WRIST] += self.offset + q[:, WRIST] @ self.K.T + slack @ self.C.T
        return joints

    def measure(self, q_joint: ArrayLike, rng: np.random.Generator) -> Array:
        """Return joints (..., 6) as fiducials would measure them, with independent Gaussian noise."""
        q = np.asarray(q_joint, dtype=np.float64)
        return q + self.noise_sd * rng.standard_normal(q.shape)


_GREY_NOISE = np.array([0.0003, 0.0003, 0.00008, 0.005, 0.012, 0.009])
"""SD between two runs of the same commands with instrument 'grey'; assumed for the other instruments."""

PSM1_GREY = CablePlant(
    radii=np.array([0.028, 0.107, 0.128]),
    a=-0.01,
    b=0.05,
    offset=np.array([0.260, -0.1065, 0.117]),
    K=np.array([[-0.015, -0.022, 0.009], [0.037, -0.053, 0.031], [-0.023, 0.196, -0.045]]),
    C=np.array([[-0.454, 0.017, -0.016], [-0.108, -0.280, 0.728], [0.085, 0.069, -0.670]]),
    noise_sd=_GREY_NOISE,
    source="recording psm1_grey_random: worn instrument 'grey 1' on PSM1",
)
PSM2_GREY = CablePlant(
    radii=np.array([0.081, 0.087, 0.095]),
    a=0.167,
    b=0.140,
    offset=np.array([0.1547, -0.138, 0.181]),
    K=np.array([[-0.003, -0.013, 0.005], [-0.027, -0.123, 0.037], [-0.001, 0.220, -0.057]]),
    C=np.array([[-0.113, 0.009, -0.012], [0.066, -0.423, 0.556], [-0.036, 0.216, -0.608]]),
    noise_sd=_GREY_NOISE,
    source="recording psm2_grey_random: worn instrument 'grey 2' on PSM2",
)
PSM1_NEW = CablePlant(
    radii=np.array([0.018, 0.040, 0.033]),
    a=0.0,
    b=0.0,
    offset=np.array([0.068, 0.0013, -0.015]),
    K=np.array([[-0.012, -0.004, 0.007], [0.011, -0.024, -0.005], [-0.008, 0.123, -0.249]]),
    C=np.array([[-0.708, 0.012, -0.012], [0.008, -0.779, 0.246], [0.032, 0.223, -0.616]]),
    noise_sd=_GREY_NOISE,
    source="recording psm1_new_random: newer instrument on PSM1",
)

PSM1_GREY_SESSIONS = CablePlant(
    radii=np.array([0.038, 0.093, 0.105]),
    a=0.078,
    b=0.150,
    offset=np.array([0.195, -0.081, 0.149]),
    K=np.array([[-0.006, -0.003, 0.027], [0.036, -0.097, 0.041], [-0.018, 0.202, -0.045]]),
    C=np.array([[-0.493, 0.020, -0.033], [-0.139, -0.394, 0.595], [0.097, 0.164, -0.655]]),
    noise_sd=_GREY_NOISE,
    source="worn instrument 'grey 1' on PSM1, mean of three recorded sessions",
)
"""Mean (geometric for radii) of the plants identified from the recordings ``psm1_grey_random``,
``psm1_grey_pick_place`` and ``psm1_grey_user_random`` (``benchmarks/bench_cell.py`` prints it)."""

PLANTS: dict[str, CablePlant] = {"psm1_grey": PSM1_GREY, "psm2_grey": PSM2_GREY, "psm1_new": PSM1_NEW}
"""Identified instruments by name."""


def play_slacks(q_cmd: Array, a: float, b: float, radii: Array, start: ArrayLike = 0.0) -> Array:
    """Return the slacks (n, 3, k) of ``[q4, q5 + a q6, q6 + b q5]`` at radii (3, k), commands (n, 6).

    The arm was at rest at the first command, with the slacks ``start``, broadcast to (3, k); all in rad.
    """
    q4, q5, q6 = q_cmd[:, 3], q_cmd[:, 4], q_cmd[:, 5]
    u = np.stack([q4, q5 + a * q6, q6 + b * q5], axis=1)[:, :, None]
    return u - play_operator(u, radii, u[0] - np.broadcast_to(start, radii.shape))


def fit_plant(recording: Recording) -> CablePlant:
    """Return the plant that fits a recording best: radii and coupling by simplex search, the rest by least squares.

    The cost is the product of the mean squared residuals of the three joints, so that no joint outweighs another.
    """
    q, valid = recording.q_cmd, recording.valid
    if valid.sum() < 30:
        raise InvalidInput(recording.name, f"has {valid.sum()} valid rows", "identifying a plant needs 30 or more")
    from scipy.optimize import minimize  # slow to import, and few callers need it

    error = (recording.q_phy - q)[:, WRIST][valid]

    def solve(x: Array) -> tuple[Array, Array]:
        slack = play_slacks(q, x[3], x[4], np.abs(x[:3, None]))[:, :, 0]
        features = np.column_stack([np.ones(len(q)), q[:, WRIST], slack])[valid]
        weights = np.asarray(np.linalg.lstsq(features, error, rcond=None)[0], dtype=np.float64)
        return weights, error - features @ weights

    def cost(x: Array) -> float:
        return float(np.log(np.mean(solve(x)[1] ** 2, axis=0) + 1e-12).sum())

    options = {"maxiter": 300, "xatol": 1e-3, "fatol": 1e-3}
    starts = ([0.05, 0.1, 0.1, 0.05, 0.05], [0.02, 0.04, 0.04, 0.0, 0.0])
    fits = [minimize(cost, x0, method="Nelder-Mead", options=options) for x0 in starts]
    x = min(fits, key=lambda fit: fit.fun).x
    weights, _ = solve(x)
    radii, shares, linear = np.abs(x[:3]), (float(x[3]), float(x[4])), (weights[0], weights[1:4].T, weights[4:7].T)
    return CablePlant(radii, *shares, *linear, _GREY_NOISE, f"fitted on {recording.name}")
