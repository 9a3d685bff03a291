"""The meaning of the numbers in a recording: arms, columns and units."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3, shown

ANGLES = {"rad": 1.0, "deg": math.pi / 180}
LENGTHS = {"m": 1.0, "mm": 1e-3}

BEYOND = 0.1
"""Share of its range by which a recorded joint may leave it: encoders drift, but wrong units exceed it by far."""

MIN_TURN_RAD = math.radians(7.0)
"""A suture turns some joint by more than this; radians read as degrees stay below a turn of 6.3 "degrees"."""

MIN_DEPTH_M = 0.5e-3
"""A suture inserts some instrument deeper than this; metres read as mm stay below."""

SLIDE = 2


@dataclass(frozen=True)
class Convention:
    """The meaning of the numbers in a set of recordings.

    Attributes:
        arms: the recorded arms, in the order of the columns; the paper recorded two.
        angles: unit of rotary joints, a key of ``ANGLES``.
        lengths: unit of the prismatic joint, or of recorded positions; a key of ``LENGTHS``.
        columns: six columns per arm, by number from 0 or by name; None: as the format defines.
        state: name of the column of a parquet file that holds the joint states.
        T_frame_base: pose of each arm's base (remote centre) in the frame of recorded poses, for recordings without
            joints; None: see ``poses.assumed_bases``.
        R_recorded_tip: rotation of the model's tip frame (z back along the jaws, y the jaw axis) in the recorded one.
    """

    arms: tuple[ArmModel, ...]
    angles: str = "rad"
    lengths: str = "m"
    columns: tuple[int, ...] | tuple[str, ...] | None = None
    state: str = "observation.state"
    T_frame_base: tuple[SE3, ...] | None = None
    R_recorded_tip: SO3 = field(default_factory=SO3.identity)

    def __post_init__(self) -> None:
        if not self.arms:
            raise TrocarError("the demonstrations name no arm; give one or more, such as psm-classic twice")
        for what, value, choices in (("angles", self.angles, ANGLES), ("lengths", self.lengths, LENGTHS)):
            if value not in choices:
                raise TrocarError(f"the unit of {what} is {value!r}; choose one of {', '.join(choices)}")
        if self.columns is not None and len(self.columns) != self.width:
            raise TrocarError(
                f"{len(self.columns)} columns are named for {len(self.arms)} arm(s); name {self.width}, six per arm"
            )
        if self.T_frame_base is not None and len(self.T_frame_base) != len(self.arms):
            raise TrocarError(f"{len(self.T_frame_base)} bases are given for {len(self.arms)} arm(s); give one per arm")

    @property
    def width(self) -> int:
        """Return the total number of joints."""
        return 6 * len(self.arms)

    def joints(self, values: NDArray[np.float64], where: str) -> NDArray[np.float64]:
        """Return recorded joint values (n, 6 arms) as (n, arms, 6) in rad and m.

        Raises:
            TrocarError: there are too few rows, a value is not finite, or a value is so far outside its joint's range
                that unit, order or arm must be wrong.
        """
        if len(values) < 2:
            raise TrocarError(f"{where} has {len(values)} row(s) of joint states; a recorded suture needs 2 or more")
        recorded = values.reshape(len(values), len(self.arms), 6)
        bad = np.argwhere(~np.isfinite(recorded))
        if len(bad):
            row, a, i = bad[0]
            raise TrocarError(
                f"{where}: row {row} holds NaN or infinity for joint '{self.arms[a].joints[i].name}' of arm {a + 1}; "
                "repair the row or leave it out"
            )
        for a, arm in enumerate(self.arms):
            self._check_ranges(arm, recorded[:, a], f"{where}, arm {a + 1}")
        q = recorded * self._scales
        self._check_motion(q, where)
        return q

    @property
    def _scales(self) -> NDArray[np.float64]:
        """Return the factors (6,) that take recorded values of one arm to rad and m."""
        turn, slide = ANGLES[self.angles], LENGTHS[self.lengths]
        return np.array([turn, turn, slide, turn, turn, turn])

    def _check_ranges(self, arm: ArmModel, recorded: NDArray[np.float64], where: str) -> None:
        """Raise if a joint of one arm (n, 6) is far out of range, and name the unit in which it would not be."""
        slack = BEYOND * (arm.upper - arm.lower)
        q = recorded * self._scales
        excess = np.maximum(arm.lower - slack - q, q - arm.upper - slack)
        over = (excess / slack).max(0)
        i = int(np.argmax(over))
        if over[i] <= 0:
            return
        joint, row = arm.joints[i], int(np.argmax(excess[:, i]))
        what, unit, units = ("lengths", self.lengths, LENGTHS) if joint.prismatic else ("angles", self.angles, ANGLES)
        half = (joint.upper - joint.lower) / 2 + slack[i]
        # A wrong unit puts the whole recording out of range; if only some rows are, these rows are wrong.
        median_is_out = np.median(np.abs(q[:, i] - joint.middle)) > half
        fitting = [name for name, scale in units.items() if np.abs(recorded[:, i] * scale - joint.middle).max() <= half]
        low, high = joint.lower / units[unit], joint.upper / units[unit]
        found = (
            f"{where}: joint '{joint.name}' of {arm.name} reaches {recorded[row, i]:.4g} {unit} at row {row}, outside "
            f"[{low:.4g}, {high:.4g}] {unit}"
        )
        if median_is_out and fitting:
            raise TrocarError(
                f'{found}: the file seems to be in {fitting[0]}; set {what} = "{fitting[0]}" in its manifest'
            )
        raise TrocarError(f"{found}; check that row, the order of the columns, the unit and the arm")

    def _check_motion(self, q: NDArray[np.float64], where: str) -> None:
        """Raise if arms (n, arms, 6), read in deg and mm, move so little that the file must be in rad or m."""
        turning = np.delete(q, SLIDE, axis=-1)
        if self.angles == "deg" and np.ptp(turning, 0).max() < MIN_TURN_RAD:
            raise TrocarError(
                f"{where}: no angle changes by more than {shown(np.ptp(turning, 0).max(), 'rad', '.2g')}, too little "
                'for a suture: the file seems to be in rad; set angles = "rad" in its manifest'
            )
        deepest_m = np.abs(q[..., SLIDE]).max()
        if self.lengths == "mm" and deepest_m < MIN_DEPTH_M:
            raise TrocarError(
                f"{where}: no instrument is inserted by more than {shown(deepest_m, 'm', '.2g')}: the file seems to be "
                'in m; set lengths = "m" in its manifest'
            )
