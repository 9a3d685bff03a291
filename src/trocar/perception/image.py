"""Images and the camera model that every camera, real or simulated, returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera with Brown's distortion, as OpenCV defines it: x right, y down, z forward.

    Attributes:
        width: pixels. height: pixels.
        fx: focal length in pixels. fy: likewise.
        cx: principal point in pixels. cy: likewise.
        distortion: k1 k2 p1 p2 k3.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Return the 3 x 3 camera matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def binned(self, factor: int) -> Intrinsics:
        """Return the camera whose pixels are ``factor`` x ``factor`` of this one's."""
        if factor < 1 or self.width % factor or self.height % factor:
            raise TrocarError(f"binning {factor} does not divide the image of {self.width} x {self.height}")
        centre = (factor - 1) / 2
        return Intrinsics(
            self.width // factor,
            self.height // factor,
            self.fx / factor,
            self.fy / factor,
            (self.cx - centre) / factor,
            (self.cy - centre) / factor,
            self.distortion,
        )


@dataclass(frozen=True, eq=False)
class RgbdImage:
    """One colour and depth image on the same pixels.

    Attributes:
        color: (height, width, 3) uint8, RGB.
        depth_m: (height, width) float32 along the optical axis; NaN where the sensor has no answer.
        intrinsics: the camera that took it.
        time_s: when, on the cell's clock.
    """

    color: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    intrinsics: Intrinsics
    time_s: float = 0.0
