"""Images and the camera model, common to real and simulated cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.checks import require_numbers
from trocar.errors import InvalidInput, InvalidValue
from trocar.geometry import SE3
from trocar.geometry.arrays import Array


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera with Brown's distortion, as in OpenCV: x right, y down, z forward."""

    width: int  # width in pixels
    height: int  # height in pixels
    fx: float  # focal length in pixels, horizontally
    fy: float  # likewise, vertically
    cx: float  # principal point in pixels, horizontally
    cy: float  # likewise, vertically
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)  # k1 k2 p1 p2 k3

    def __post_init__(self) -> None:
        require_numbers(self)

    @property
    def matrix(self) -> Array:
        """Return the 3 x 3 camera matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def binned(self, factor: int) -> Intrinsics:
        """Return the camera whose pixels combine ``factor`` x ``factor`` pixels of this one."""
        if factor < 1 or self.width % factor or self.height % factor:
            problem = f"does not divide the image of {self.width} x {self.height} pixels"
            raise InvalidInput(f"binning by {factor}", problem, "give a divisor")
        size, centre = (self.width // factor, self.height // factor), (factor - 1) / 2
        middle = (self.cx - centre) / factor, (self.cy - centre) / factor
        return Intrinsics(*size, self.fx / factor, self.fy / factor, *middle, self.distortion)

    def cropped(self, corner_px: tuple[int, int], size_px: tuple[int, int]) -> Intrinsics:
        """Return the camera that reads out only a rectangle of this one's pixels, from its first pixel (u, v) on."""
        (u, v), (width, height) = corner_px, size_px
        if min(u, v) < 0 or min(width, height) < 1 or u + width > self.width or v + height > self.height:
            item = f"the rectangle of {width} x {height} pixels at {corner_px}"
            raise InvalidInput(item, f"leaves the image of {self.width} x {self.height} pixels", "choose one inside")
        return Intrinsics(width, height, self.fx, self.fy, self.cx - u, self.cy - v, self.distortion)


@dataclass(frozen=True, eq=False)
class RgbdImage:
    """A colour and a depth image with common pixels; the arrays must have the size of the camera's image."""

    color: NDArray[np.uint8]  # (height, width, 3) uint8, RGB
    depth_m: NDArray[np.float32]  # (height, width) float32 along the optical axis; NaN where the sensor has no value
    intrinsics: Intrinsics
    time_s: float = 0.0  # time of the image on the cell's clock

    def __post_init__(self) -> None:
        _require_colors("an RGBD image", self.color, self.intrinsics)
        size = (self.intrinsics.height, self.intrinsics.width)
        if self.depth_m.shape != size:
            raise InvalidValue("depth of an RGBD image", f"of shape {self.depth_m.shape}", f"it needs {size}")


@dataclass(frozen=True)
class StereoRig:
    """Two cameras side by side that expose together."""

    left: Intrinsics  # the camera that poses refer to
    right: Intrinsics
    T_left_right: SE3  # pose of the right camera in the left one; for a rectified pair a shift along x alone


@dataclass(frozen=True, eq=False)
class StereoImage:
    """Two colour images of one moment; they must have the sizes of their cameras' images."""

    left: NDArray[np.uint8]  # (height, width, 3) uint8, RGB
    right: NDArray[np.uint8]  # likewise
    rig: StereoRig
    time_s: float = 0.0  # when, on the cell's clock

    def __post_init__(self) -> None:
        _require_colors("the left image of a pair", self.left, self.rig.left)
        _require_colors("the right image of a pair", self.right, self.rig.right)


@dataclass(frozen=True)
class Window:
    """A rectangle of a camera's pixels."""

    corner_px: tuple[int, int]  # (u, v) of its first pixel
    size_px: tuple[int, int]  # (width, height)


@dataclass(frozen=True)
class StereoWindow:
    """A rectangle of each eye's pixels; both begin in the same row if the pair is to stay rectified."""

    left: Window
    right: Window
    binning: int = 1  # the sensors combine this many by this many pixels; corners and sizes are multiples of it

    def __post_init__(self) -> None:
        for window in (self.left, self.right):
            if self.binning < 1 or any(number % self.binning for number in (*window.corner_px, *window.size_px)):
                problem = f"does not divide the window of {window.size_px} pixels at {window.corner_px}"
                raise InvalidInput(f"binning by {self.binning}", problem, "give multiples of it")

    def of(self, rig: StereoRig) -> StereoRig:
        """Return the pair that reads out only these rectangles (InvalidInput: a rectangle leaves its image)."""
        left, right = (
            eye.cropped(window.corner_px, window.size_px).binned(self.binning)
            for eye, window in ((rig.left, self.left), (rig.right, self.right))
        )
        return StereoRig(left, right, rig.T_left_right)


CameraModel = Intrinsics | StereoRig
Image = RgbdImage | StereoImage


def read_out(model: CameraModel, window: Window | StereoWindow | None) -> CameraModel:
    """Return the camera that reads out only a window, or all pixels if ``window`` is None.

    Raises:
        InvalidInput: the window leaves the image, or is for another kind of camera.
    """
    if window is None:
        return model
    if isinstance(model, StereoRig) and isinstance(window, StereoWindow):
        return window.of(model)
    if isinstance(model, Intrinsics) and isinstance(window, Window):
        return model.cropped(window.corner_px, window.size_px)
    kind, have = ("StereoWindow", "two lenses") if isinstance(model, StereoRig) else ("Window", "one lens")
    raise InvalidInput(f"a camera of {have}", f"cannot read out {window!r}", f"give a {kind}")


def _require_colors(item: str, color: NDArray[np.uint8], lens: Intrinsics) -> None:
    wanted = (lens.height, lens.width, 3)
    if color.shape != wanted or color.dtype != np.uint8:
        raise InvalidValue(item, f"{color.dtype} of shape {color.shape}", f"its camera takes uint8 {wanted}")


def whole_window(model: CameraModel) -> Window | StereoWindow:
    """Return the window of all pixels; a camera keeps only images that were taken without a window."""
    if isinstance(model, Intrinsics):
        return Window((0, 0), (model.width, model.height))
    left, right = (Window((0, 0), (eye.width, eye.height)) for eye in (model.left, model.right))
    return StereoWindow(left, right)
