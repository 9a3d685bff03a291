"""How hard a laboratory is: the sizes of the differences between it and what is known about it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError

RECORDED, MILD, HARSH = "recorded", "mild", "harsh"
LEVELS = (MILD, RECORDED, HARSH)
DEFAULT = RECORDED
HARSHER = 2.0
"""Factor on the recorded sizes in a harsh laboratory."""
MOST_SCALE = 100.0
"""Maximum factor on a flaw's recorded size; larger errors are no longer those of a laboratory."""
UNITS = {
    "m": ("m", 1.0),
    "mm": ("m", 1e-3),
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180.0),
    "x": ("", 1.0),
    "": ("", 1.0),
}
SHOWN = {"m": ("mm", 1e3), "rad": ("deg", 180.0 / math.pi), "": ("", 1.0)}
DEPTH_M = 0.15
"""Angles of the outer joints count as lengths at this depth below the remote centre."""


@dataclass(frozen=True)
class Flaw:
    """One way in which a laboratory differs from what is known about it.

    Its size is the root mean square of its values or, for a flaw without a unit, a multiple of the recorded one.

    Attributes:
        about: what it is.
        unit: 'm', 'rad', or '' if its values have several units, or none.
        recorded: its values as recordings show them.
        mild: its values in the cell that is easier than that.
        source: where the values come from.
    """

    about: str
    unit: str
    recorded: tuple[float, ...]
    mild: tuple[float, ...]
    source: str

    def values(self, level: str) -> NDArray[np.float64]:
        """Return the values at a level of difficulty."""
        if level == MILD:
            return np.array(self.mild)
        return np.array(self.recorded) * (HARSHER if level == HARSH else 1.0)

    def size(self, values: NDArray[np.float64]) -> float:
        """Return the size of such values."""
        size = float(np.sqrt(np.mean(np.square(values))))
        return size if self.unit else size / float(np.sqrt(np.mean(np.square(self.recorded))))

    def sized(self, size: float) -> NDArray[np.float64]:
        """Return the recorded values, scaled to this size."""
        return np.array(self.recorded) * (size / self.size(np.array(self.recorded)))


FLAWS: dict[str, Flaw] = {
    "offsets": Flaw(
        "offsets of the wrist's cables, from session to session (SD of q4 q5 q6)",
        "rad",
        (0.057, 0.069, 0.029),
        (0.03, 0.04, 0.04),
        "three sessions of instrument 'grey 1' (benchmarks/bench_cell.py)",
    ),
    "wear": Flaw(
        "play, coupling and gains of the wrist's cables, from session to session (SD of the radii's logarithms, of the "
        "shares a and b, of K, of C)",
        "",
        (0.35, 0.05, 0.024, 0.08),
        (0.0, 0.0, 0.0, 0.0),
        "three sessions of instrument 'grey 1' (benchmarks/bench_cell.py)",
    ),
    "residual": Flaw(
        "error of the wrist that fits no model's family (SD of q4 q5 q6)",
        "rad",
        (0.006, 0.022, 0.015),
        (0.0, 0.0, 0.0),
        "what the play model leaves on recordings, in size and correlation (benchmarks/bench_cell.py)",
    ),
    "noise": Flaw(
        "error of the wrist that no run repeats (SD of q4 q5 q6), fading within seconds",
        "rad",
        (0.0040, 0.0110, 0.0080),
        tuple((np.array([0.005, 0.012, 0.009]) * np.sqrt(0.5)).tolist()),
        "two runs of the same commands, .005 .012 .009, of which white noise of the measurement is what residuals lose "
        "from one sample to the next (benchmarks/bench_cell.py)",
    ),
    "creep": Flaw(
        "offsets of the wrist that wander within a session, over minutes (SD of q4 q5 q6)",
        "rad",
        (0.003, 0.002, 0.004),
        (0.0, 0.0, 0.0),
        "correlation of the play model's residuals at 100 samples (benchmarks/bench_cell.py)",
    ),
    "outer": Flaw(
        "error of the outer joints: gains, play, and what fits no model's family (SD of q1 q2 at 150 mm and of q3 "
        "that a linear model leaves)",
        "m",
        (0.0011 * DEPTH_M, 0.0016 * DEPTH_M, 0.00034),
        (0.0, 0.0, 0.0),
        "recordings of four instruments (benchmarks/bench_cell.py)",
    ),
    "kinematics": Flaw(
        "error of a Raven II's joints against its encoders",
        "",
        (1.0,),
        (1.0,),
        "pose errors of a Raven II, gripper_pose_pairs",
    ),
    "registration": Flaw(
        "error of a base's registration, on top of what errors of the outer joints cause (SD on each axis)",
        "m",
        (0.0002,),
        (0.0,),
        "assumed: a camera or an arm is touched; the recorded sets' residuals lie along the outer joints and come with "
        "`outer` (benchmarks/bench_cell.py)",
    ),
    "cameras": Flaw(
        "error of a further camera's registration against the first (SD on each axis)",
        "m",
        (0.0001,),
        (0.0,),
        "assumed: what images of a checkerboard leave .35 m away",
    ),
    "tool": Flaw(
        "error of the wrist's length, from its pitch axis to the jaws' axis (SD)",
        "m",
        (0.0002,),
        (0.0,),
        "assumed",
    ),
    "print": Flaw(
        "deviation of pegs and blocks from their drawings: places of the pegs, sizes of both (SD)",
        "m",
        (0.0001,),
        (0.0,),
        "assumed: tolerance of printers, as for the spheres of a calibration",
    ),
    "needle": Flaw(
        "place of a needle that a person loads against the agreed one (1 x: SD of .3 mm on each axis, 3 deg about it)",
        "",
        (0.0003, 0.0524),
        (0.0, 0.0),
        "assumed",
    ),
    "depth": Flaw(
        "scatter of depth (1 x is 2.1 times the scatter of the station's camera)",
        "",
        (2.1,),
        (1.0,),
        "real capture of a block's top: .34 mm, against .16 mm",
    ),
    "jaw": Flaw(
        "error of the jaws' angle against the command (SD of an offset in each session; their play is as wide)",
        "rad",
        (0.03,),
        (0.0,),
        "assumed",
    ),
}
"""All flaws by name."""


@dataclass(frozen=True, eq=False)
class Difficulty:
    """The sizes of all flaws.

    Attributes:
        level: of the flaws that are not named separately.
        values: by name of the flaw.
        named: flaws that were given their own size, as requested.
    """

    level: str
    values: Mapping[str, NDArray[np.float64]]
    named: tuple[str, ...] = ()

    @staticmethod
    def of(level: str, named: Iterable[str] = ()) -> Difficulty:
        """Return a level of difficulty, with other sizes for some flaws.

        Args:
            level: 'mild', 'recorded' or 'harsh'.
            named: as ``registration=1.0mm``, ``offsets=3deg``, ``wear=2`` or ``creep=0``.

        Raises:
            TrocarError: there is no such level or flaw, or the size is not valid.
        """
        if level not in LEVELS:
            raise TrocarError(f"difficulty {level!r} is unknown; choose one of {', '.join(LEVELS)}")
        values = {name: flaw.values(level) for name, flaw in FLAWS.items()}
        named = tuple(named)
        sizes = [_sized(text) for text in named]
        for name, size in sizes:
            if [other for other, _ in sizes].count(name) > 1:
                raise TrocarError(f"flaw {name!r} is given twice; give it one size")
            values[name] = FLAWS[name].sized(size)
        return Difficulty(level, values, named)

    def __getitem__(self, flaw: str) -> NDArray[np.float64]:
        """Return the values of a flaw."""
        return self.values[flaw]

    def scale(self, flaw: str) -> float:
        """Return the size of a flaw as a multiple of the recorded one."""
        kind = FLAWS[flaw]
        return kind.size(self.values[flaw]) / kind.size(np.array(kind.recorded))

    def sizes(self) -> dict[str, str]:
        """Return the sizes of all flaws, for display."""
        found = {}
        for name, flaw in FLAWS.items():
            found[name] = _shown(name, flaw.size(self.values[name]))
        return found


def _sized(text: str) -> tuple[str, float]:
    """Return the name and size of a flaw given as text."""
    name, _, size = text.partition("=")
    if name not in FLAWS:
        raise TrocarError(f"flaw {name!r} is unknown; choose one of {', '.join(FLAWS)}")
    match = re.fullmatch(r"\s*(-?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*([a-z]*)\s*", size)
    kind, factor = UNITS.get(match[2], ("unknown", 1.0)) if match else ("unknown", 1.0)
    if match is None or not math.isfinite(float(match[1])) or (kind != FLAWS[name].unit and float(match[1]) != 0.0):
        units = [unit for unit, (kind, _) in UNITS.items() if kind == FLAWS[name].unit and unit]
        how = "how many times what was recorded" if "x" in units else f"a number in {' or '.join(units)}"
        raise TrocarError(f"flaw {text!r} has no size that can be read; give {how}, as in '{_example(name)}'")
    if match[1].startswith("-"):
        raise TrocarError(f"flaw {text!r} has a negative size; give 0 or more, as in '{_example(name)}'")
    given, most = float(match[1]) * factor, MOST_SCALE * FLAWS[name].size(np.array(FLAWS[name].recorded))
    if given > most:
        raise TrocarError(
            f"flaw {text!r} is more than {MOST_SCALE:g} times what was recorded; give {_shown(name, most)} or less"
        )
    return name, given


def _shown(name: str, size: float) -> str:
    unit, factor = SHOWN[FLAWS[name].unit]
    return f"{factor * size:.3g} {unit}" if unit else f"{size:.3g} x"


def _example(name: str) -> str:
    return f"{name}={({'m': '1.0mm', 'rad': '2deg', '': '2x'})[FLAWS[name].unit]}"
