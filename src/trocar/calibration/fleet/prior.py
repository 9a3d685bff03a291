"""What is known of an instrument's cables before it was measured."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.archive import Archive, read_archive
from trocar.calibration.fleet.loops import FEATURES
from trocar.calibration.models.base import shaped
from trocar.errors import TrocarError

FORMAT = "trocar fleet prior"
VERSION = 1
BUILT_IN = "fleet"
"""Name of the prior that comes with Trocar."""
_SHAPES = {
    "shape_mean": (5,),
    "shape_sd": (5,),
    "weights": (3, FEATURES),
    "factors": (3, FEATURES, FEATURES),
    "noise_sd": (3,),
    "outer_sd": (3, 7),
    "outer_noise_sd": (3,),
}


@dataclass(frozen=True, eq=False)
class FleetPrior:
    """Normal distributions of what a fit looks for, over instruments and sessions.

    Attributes:
        shape_mean: (5,) of ``LoopShape.theta``.
        shape_sd: (5,) likewise.
        weights: (3, FEATURES) mean of the map from ``LoopShape.features`` to the errors of q4 q5 q6.
        factors: (3, FEATURES, FEATURES) lower Cholesky factors of its covariance, joint by joint.
        noise_sd: (3,) of what such a map leaves of a measurement, rad.
        outer_sd: (3, 7) of the errors of q1 q2 q3 as maps of 1 and the command, whose mean is 0; rad and m.
        outer_noise_sd: (3,) of what these leave, rad and m.
        sources: names of the recordings that it was learned from.
    """

    shape_mean: NDArray[np.float64]
    shape_sd: NDArray[np.float64]
    weights: NDArray[np.float64]
    factors: NDArray[np.float64]
    noise_sd: NDArray[np.float64]
    outer_sd: NDArray[np.float64]
    outer_noise_sd: NDArray[np.float64]
    sources: tuple[str, ...]

    def save(self, path: str | Path) -> Path:
        """Write the prior to an ``.npz`` file."""
        path = Path(path)
        if path.suffix != ".npz":
            raise TrocarError(f"prior {str(path)!r} must end in .npz; choose such a name")
        header = {"format": FORMAT, "version": VERSION, "sources": list(self.sources)}
        return Archive(header, {name: getattr(self, name) for name in _SHAPES}).save(path)


def load_prior(name: str | Path) -> FleetPrior:
    """Return the built-in prior (``fleet``), or that in a file.

    Raises:
        TrocarError: there is no such file, or it is no prior.
    """
    if str(name) == BUILT_IN:
        with as_file(files("trocar.calibration.fleet") / "fleet.npz") as path:
            return _load(path)
    return _load(Path(name))


def _load(path: Path) -> FleetPrior:
    archive = read_archive(path, FORMAT, VERSION)
    sources = archive.header.get("sources")
    try:
        if not isinstance(sources, list) or not all(isinstance(source, str) for source in sources):
            raise TrocarError("it does not say what it was learned from")
        arrays = {name: np.asarray(a, dtype=np.float64) for name, a in shaped(archive.arrays, **_SHAPES).items()}
        for name in ("shape_sd", "noise_sd", "outer_sd", "outer_noise_sd"):
            if (arrays[name] <= 0).any():
                raise TrocarError(f"{name!r} holds what is no standard deviation")
    except TrocarError as error:
        raise TrocarError(f"prior {str(path)!r} is damaged: {error}; learn it again") from None
    return FleetPrior(**arrays, sources=tuple(sources))
