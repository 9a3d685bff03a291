"""How hard a laboratory is: the sizes of its flaws, the differences between it and what is known about it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from trocar.errors import InvalidInput, UnknownName
from trocar.geometry.arrays import Array
from trocar.registry import Registry

RECORDED, MILD, HARSH = "recorded", "mild", "harsh"
LEVELS = (MILD, RECORDED, HARSH)
DEFAULT = RECORDED
HARSHER = 2.0
"""Factor on the recorded sizes in a harsh laboratory."""
MOST_SCALE = 100.0
"""Maximum factor on a flaw's recorded size; no laboratory has larger errors."""
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
        name: name in ``FLAWS`` and for ``--flaw``.
        about: description.
        unit: 'm', 'rad', or '' if its values have several units, or none.
        recorded: values as recordings show them.
        mild: values in a mild laboratory.
        source: where the values come from.
        tasks: names of the tasks that it affects; empty: every task at a station with the parts that have it.
    """

    name: str
    about: str
    unit: str
    recorded: tuple[float, ...]
    mild: tuple[float, ...]
    source: str
    tasks: tuple[str, ...] = ()

    def values(self, level: str) -> Array:
        """Return the values at a level of difficulty."""
        if level == MILD:
            return np.array(self.mild)
        return np.array(self.recorded) * (HARSHER if level == HARSH else 1.0)

    @property
    def recorded_size(self) -> float:
        """Return the size of the recorded values."""
        return self.size(np.array(self.recorded))

    def size(self, values: Array) -> float:
        """Return the size of values of this flaw."""
        size = float(np.sqrt(np.mean(np.square(values))))
        return size if self.unit else size / float(np.sqrt(np.mean(np.square(self.recorded))))

    def sized(self, size: float) -> Array:
        """Return the recorded values, scaled to this size."""
        return np.array(self.recorded) * (size / self.recorded_size)

    def shown(self, size: float) -> str:
        """Return a size for people, with its unit."""
        unit, factor = SHOWN[self.unit]
        return f"{factor * size:.3g} {unit or 'x'}"

    def parse(self, text: str) -> float:
        """Return the size that a user wrote as ``1.0mm``, ``3deg`` or ``2x``, in m, rad or without a unit.

        Raises:
            InvalidInput: it is not a size, is negative, or exceeds ``MOST_SCALE`` times the recorded one.
        """
        example = f"as in '{self.name}={({'m': '1.0mm', 'rad': '2deg', '': '2x'})[self.unit]}'"
        item = f"flaw '{self.name}={text}'"
        match = re.fullmatch(r"\s*(-?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*([a-z]*)\s*", text)
        kind, factor = UNITS.get(match[2], ("unknown", 1.0)) if match else ("unknown", 1.0)
        if match is None or not math.isfinite(float(match[1])) or (kind != self.unit and float(match[1]) != 0.0):
            units = [unit for unit, (kind, _) in UNITS.items() if kind == self.unit and unit]
            how = f"a number in {' or '.join(units)}" if self.unit else "how many times what was recorded"
            raise InvalidInput(item, "has no size that can be read", f"give {how}, {example}")
        if match[1].startswith("-"):
            raise InvalidInput(item, "has a negative size", f"give 0 or more, {example}")
        size, most = float(match[1]) * factor, MOST_SCALE * self.recorded_size
        if size > most:
            raise InvalidInput(
                item, f"is more than {MOST_SCALE:g} times what was recorded", f"give {self.shown(most)} or less"
            )
        return size


_OF_LABORATORIES = (
    Flaw(
        "offsets",
        "offsets of the wrist's cables, from session to session (SD of q4 q5 q6)",
        "rad",
        (0.057, 0.069, 0.029),
        (0.03, 0.04, 0.04),
        "three sessions of instrument 'grey 1' (benchmarks/bench_cell.py)",
    ),
    Flaw(
        "wear",
        "play, coupling and gains of the wrist's cables, from session to session (SD of the radii's logarithms, of the "
        "shares a and b, of K, of C)",
        "",
        (0.35, 0.05, 0.024, 0.08),
        (0.0, 0.0, 0.0, 0.0),
        "three sessions of instrument 'grey 1' (benchmarks/bench_cell.py)",
    ),
    Flaw(
        "residual",
        "error of the wrist that fits no model's family (SD of q4 q5 q6)",
        "rad",
        (0.006, 0.022, 0.015),
        (0.0, 0.0, 0.0),
        "what the play model leaves on recordings, in size and correlation (benchmarks/bench_cell.py)",
    ),
    Flaw(
        "noise",
        "error of the wrist that no run repeats (SD of q4 q5 q6), fading within seconds",
        "rad",
        (0.0040, 0.0110, 0.0080),
        tuple((np.array([0.005, 0.012, 0.009]) * np.sqrt(0.5)).tolist()),
        "two runs of the same commands, .005 .012 .009, of which white noise of the measurement is what residuals lose "
        "from one sample to the next (benchmarks/bench_cell.py)",
    ),
    Flaw(
        "creep",
        "offsets of the wrist that wander within a session, over minutes (SD of q4 q5 q6)",
        "rad",
        (0.003, 0.002, 0.004),
        (0.0, 0.0, 0.0),
        "correlation of the play model's residuals at 100 samples (benchmarks/bench_cell.py)",
    ),
    Flaw(
        "outer",
        "error of the outer joints: gains, play, and what fits no model's family (SD of q1 q2 at 150 mm and of q3 "
        "that a linear model leaves)",
        "m",
        (0.0011 * DEPTH_M, 0.0016 * DEPTH_M, 0.00034),
        (0.0, 0.0, 0.0),
        "recordings of four instruments (benchmarks/bench_cell.py)",
    ),
    Flaw(
        "kinematics",
        "error of a Raven II's joints against its encoders",
        "",
        (1.0,),
        (1.0,),
        "pose errors of a Raven II, gripper_pose_pairs",
    ),
    Flaw(
        "registration",
        "error of a base's registration, on top of what errors of the outer joints cause (SD on each axis)",
        "m",
        (0.0002,),
        (0.0,),
        "assumed: a camera or an arm is touched; the recorded sets' residuals lie along the outer joints and come with "
        "`outer` (benchmarks/bench_cell.py)",
    ),
    Flaw(
        "cameras",
        "error of a further camera's registration against the first (SD on each axis)",
        "m",
        (0.0001,),
        (0.0,),
        "assumed: what images of a checkerboard leave .35 m away",
    ),
    Flaw(
        "tool",
        "error of the wrist's length, from its pitch axis to the jaws' axis (SD)",
        "m",
        (0.0002,),
        (0.0,),
        "assumed",
    ),
    Flaw(
        "depth",
        "scatter of depth (1 x is 2.1 times the scatter of the station's camera)",
        "",
        (2.1,),
        (1.0,),
        "real capture of a block's top: .34 mm, against .16 mm",
    ),
    Flaw(
        "jaw",
        "error of the jaws' angle against the command (SD of an offset in each session; their play is as wide)",
        "rad",
        (0.03,),
        (0.0,),
        "assumed",
    ),
)

FLAWS: Registry[Flaw] = Registry("flaw", "trocar.flaws", {flaw.name: flaw for flaw in _OF_LABORATORIES})
"""All flaws by name: those of laboratories, and those that tasks bring (entry points ``trocar.flaws``)."""


@dataclass(frozen=True, eq=False)
class Difficulty:
    """The sizes of all flaws.

    Attributes:
        level: level of the flaws that have no size of their own.
        named: flaws with a size of their own, as the user wrote them.
        sizes: their sizes, by name.
    """

    level: str
    named: tuple[str, ...]
    sizes: Mapping[str, float]

    @staticmethod
    def of(level: str, named: Iterable[str] = ()) -> Difficulty:
        """Return a level of difficulty, with sizes of their own for some flaws.

        Args:
            level: 'mild', 'recorded' or 'harsh'.
            named: as ``registration=1.0mm``, ``offsets=3deg``, ``wear=2`` or ``creep=0``.

        Raises:
            UnknownName: there is no such level or flaw.
            InvalidInput: a size is not valid, or a flaw is given twice.
        """
        if level not in LEVELS:
            raise UnknownName("difficulty", level, LEVELS)
        named, sizes = tuple(named), dict[str, float]()
        for text in named:
            name, _, size = text.partition("=")
            flaw = FLAWS.pick(name)
            if name in sizes:
                raise InvalidInput(f"flaw {name!r}", "is given twice", "give it one size")
            sizes[name] = flaw.parse(size)
        return Difficulty(level, named, sizes)

    def __getitem__(self, flaw: str) -> Array:
        """Return the values of a flaw in ``FLAWS``."""
        return self.values(FLAWS.pick(flaw))

    def values(self, flaw: Flaw) -> Array:
        """Return the values of a flaw."""
        return flaw.sized(self.sizes[flaw.name]) if flaw.name in self.sizes else flaw.values(self.level)

    def scale(self, flaw: str) -> float:
        """Return the size of a flaw as a multiple of the recorded one."""
        return FLAWS[flaw].size(self[flaw]) / FLAWS[flaw].recorded_size

    def shown(self, flaw: str) -> str:
        """Return the size of a flaw for people."""
        return FLAWS[flaw].shown(FLAWS[flaw].size(self[flaw]))
