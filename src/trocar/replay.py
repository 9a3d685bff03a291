"""What a trial looked like: solids, where they were at every tick, tool paths, contacts, images; needs no simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3

SHAPES = ("box", "sphere", "capsule", "cylinder", "hull")


@dataclass(frozen=True, eq=False)
class Solid:
    """One convex solid on a body.

    Attributes:
        body: name in ``Replay.T_world_body``.
        shape: one of ``SHAPES``; capsules and cylinders lie along z.
        size_m: box: three half lengths; sphere: radius; capsule and cylinder: radius, half length; hull: empty.
        T_body_solid: where it sits on its body.
        rgba: colour in [0, 1], sRGB.
        vertices_m: (n, 3) corners of a hull in the solid's frame; else (0, 3).
    """

    body: str
    shape: str
    size_m: tuple[float, ...]
    T_body_solid: SE3
    rgba: tuple[float, float, float, float]
    vertices_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))


def painted(solids: Sequence[Solid], colours: Mapping[str, tuple[float, float, float]]) -> tuple[Solid, ...]:
    """Return solids in display colours; solids that no entry matches keep theirs.

    Args:
        solids: of any bodies.
        colours: RGB by the beginning of body and shape, such as ``"board capsule"`` or ``"board"``.
    """

    def one(solid: Solid) -> Solid:
        rgb = next((rgb for start, rgb in colours.items() if f"{solid.body} {solid.shape}".startswith(start)), None)
        return solid if rgb is None else replace(solid, rgba=(*rgb, solid.rgba[3]))

    return tuple(map(one, solids))


@dataclass(frozen=True)
class Viewpoint:
    """Where a picture of the cell is taken from. It is aimed at what fills its frame (``TaskReport.frame``).

    Attributes:
        eye_m: (3,) in the world.
    """

    eye_m: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class ToolPath:
    """The planned and the driven path of one arm's tip.

    Attributes:
        p_world_planned_m: (n, 3) at ``Replay.times_s``, from the script's joints and the registered base.
        p_world_driven_m: (n, 3) the true tip; for real arms, the tip from their encoders.
    """

    p_world_planned_m: NDArray[np.float64]
    p_world_driven_m: NDArray[np.float64]


@dataclass(frozen=True)
class Goal:
    """One arm's work on one goal.

    Attributes:
        arm: name.
        number: the goal's number, from 0 on.
        start_s: when the arm began.
        end_s: when it ended.
        failed: whether the goal was missed.
    """

    arm: str
    number: int
    start_s: float
    end_s: float
    failed: bool = False


@dataclass(frozen=True)
class Contact:
    """One contact that the referee noted.

    Attributes:
        time_s: when it began.
        end_s: when it ended.
        between: names of the two bodies that touched.
        p_world_m: where the force was largest.
        force_n: largest force while it lasted.
    """

    time_s: float
    end_s: float
    between: tuple[str, str]
    p_world_m: tuple[float, float, float]
    force_n: float


@dataclass(frozen=True, eq=False)
class CameraImage:
    """One image as it was taken.

    Attributes:
        time_s: end of the exposure.
        camera: name.
        encoded: bytes of a WebP or PNG file.
    """

    time_s: float
    camera: str
    encoded: bytes

    def __repr__(self) -> str:
        return f"<CameraImage of {self.camera} at {self.time_s:.2f} s, {len(self.encoded)} bytes>"


@dataclass(frozen=True, eq=False)
class Replay:
    """Everything that is needed to watch a trial again.

    Attributes:
        title: one line.
        times_s: (n,) increasing, 100 Hz.
        solids: everything visible.
        T_world_body: pose of each body: (n,), or () if it never moves.
        tools: path of each arm's tip, by arm.
        ports_m: (3,) remote centre of each arm, in the world, by arm: its shaft always passes through it.
        goals: what the arms worked on.
        contacts: in order of time.
        spans: (arm, name, start_s, end_s) of the scripts.
        events: dicts with ``name`` and ``time_s``.
        joints: per arm, those available of the (n, 7) arrays ``desired``, ``commanded``, ``measured``, ``true`` (six
            joints and the jaw).
        joint_names: per arm, seven names.
        images: as the cameras took them.
    """

    title: str
    times_s: NDArray[np.float64]
    solids: tuple[Solid, ...]
    T_world_body: Mapping[str, SE3]
    tools: Mapping[str, ToolPath] = field(default_factory=dict)
    contacts: tuple[Contact, ...] = ()
    ports_m: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    goals: tuple[Goal, ...] = ()
    spans: tuple[tuple[str, str, float, float], ...] = ()
    events: tuple[Mapping[str, object], ...] = ()
    joints: Mapping[str, Mapping[str, NDArray[np.float64]]] = field(default_factory=dict)
    joint_names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    images: tuple[CameraImage, ...] = ()

    def __repr__(self) -> str:
        lasts_s = self.times_s[-1] if len(self.times_s) else 0.0
        return f"<Replay {self.title!r}: {lasts_s:.1f} s, {len(self.solids)} solids, {len(self.images)} images>"
