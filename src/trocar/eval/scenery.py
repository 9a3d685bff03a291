"""The visible scene of a trial as plain values, enough to draw it again without the simulator or the task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk, frames
from trocar.errors import InvalidInput
from trocar.eval.turns import turns_of
from trocar.geometry import SE3, SO3
from trocar.replay import CameraImage, Contact, Goal, Replay, Solid, ToolPath

if TYPE_CHECKING:
    from trocar.eval.trial import Trial


@dataclass(frozen=True, eq=False)
class Scenery:
    """Solids, arms and fixed bodies.

    Attributes:
        solids: everything visible.
        T_world_body: poses of the bodies that never move.
        arms: model of each arm by name.
        T_world_base: true poses of the bases; empty if unknown.
        T_world_base_registered: poses of the bases that registration found.
        cameras: times and blob names of each camera's images: ``[[time_s, blob], ...]`` by name.
        tick_s: time between two rows of a trial's arrays.
    """

    solids: tuple[Solid, ...]
    T_world_body: Mapping[str, SE3]
    arms: Mapping[str, ArmModel]
    T_world_base: Mapping[str, SE3]
    T_world_base_registered: Mapping[str, SE3]
    cameras: Mapping[str, list[tuple[float, str]]]
    tick_s: float

    def __repr__(self) -> str:
        return f"<Scenery of {len(self.solids)} solids, arms {', '.join(self.arms)}>"

    def values(self) -> dict[str, Any]:
        """Return the scenery as JSON values."""
        return {
            "solids": [_solid_values(solid) for solid in self.solids],
            "T_world_body": _pose_values(self.T_world_body),
            "arms": {name: asdict(arm) for name, arm in self.arms.items()},
            "T_world_base": _pose_values(self.T_world_base),
            "T_world_base_registered": _pose_values(self.T_world_base_registered),
            "cameras": {name: [list(image) for image in images] for name, images in self.cameras.items()},
            "tick_s": self.tick_s,
        }

    @staticmethod
    def of(values: Mapping[str, Any]) -> Scenery:
        """Return the scenery from the result of :meth:`values`."""
        return Scenery(
            solids=tuple(_solid_of(solid) for solid in values["solids"]),
            T_world_body=_poses_of(values["T_world_body"]),
            arms={name: arm_of(arm) for name, arm in values["arms"].items()},
            T_world_base=_poses_of(values["T_world_base"]),
            T_world_base_registered=_poses_of(values["T_world_base_registered"]),
            cameras={
                name: [(float(time_s), str(blob)) for time_s, blob in images]
                for name, images in values["cameras"].items()
            },
            tick_s=float(values["tick_s"]),
        )

    def replay(self, trial: Trial) -> Replay:
        """Return the replay of a trial with this scenery."""
        about = trial.about
        title = " ".join(str(about[key]) for key in ("task", "variant", "method") if about.get(key))
        title += " on a robot, as its encoders read" if trial.on_robot else ""
        return replace(
            self.shown(title, trial.times_s, trial.arrays),
            goals=_goals(trial),
            contacts=tuple(contact_of(collision) for collision in trial.collisions),
            spans=tuple((s.arm, s.name, s.start_s, s.end_s) for s in trial.spans),
            events=tuple(trial.events),
            images=tuple(
                CameraImage(time_s, camera, trial.images[blob])
                for camera, images in self.cameras.items()
                for time_s, blob in images
                if blob in trial.images
            ),
        )

    def shown(
        self, title: str, times_s: NDArray[np.float64], arrays: Mapping[str, NDArray], planned: str = "desired"
    ) -> Replay:
        """Return a replay of arms and bodies alone.

        Args:
            title: title in one line.
            times_s: (n,) times of the rows.
            arrays: arrays named as those of a trial; measured joints are drawn where the true ones are unknown.
            planned: kind of joints of which the planned paths are drawn.
        """
        bodies: dict[str, SE3] = dict(self.T_world_body)
        tools: dict[str, ToolPath] = {}
        ports_m: dict[str, NDArray[np.float64]] = {}
        for name, arm in self.arms.items():
            known = f"true_{name}" in arrays
            kind, base = ("true", self.T_world_base) if known else ("measured", self.T_world_base_registered)
            driven = arrays[f"{kind}_{name}"].astype(np.float64)
            bodies |= link_poses(name, arm, base[name], driven)
            ports_m[name] = base[name].translation_m
            asked = arrays.get(f"{planned}_{name}", driven).astype(np.float64)
            tools[name] = ToolPath(
                (self.T_world_base_registered[name] @ fk(arm, asked[:, :6])).translation_m,
                (base[name] @ fk(arm, driven[:, :6])).translation_m,
            )
        for key, rows in arrays.items():
            if key.startswith("body_"):
                rows = rows.astype(np.float64)  # noqa: PLW2901
                bodies[key.removeprefix("body_")] = SE3.from_parts(SO3.from_quaternion(rows[:, 3:]), rows[:, :3])
        kinds = ("desired", "commanded", "measured", "true")
        return Replay(
            title,
            times_s,
            self.solids,
            bodies,
            tools,
            ports_m=ports_m,
            joints={
                name: {kind: arrays[f"{kind}_{name}"] for kind in kinds if f"{kind}_{name}" in arrays}
                for name in self.arms
            },
            joint_names={name: (*(j.name for j in arm.joints), "jaw") for name, arm in self.arms.items()},
        )


def _goals(trial: Trial) -> tuple[Goal, ...]:
    """Return the work of each arm on each goal; if no arm was noted, of all working arms."""

    def failed(number: int) -> bool:
        score = trial.scores[number] if number < len(trial.scores) else {"attempted": False}
        return bool(score["attempted"]) and not score["succeeded"]

    return tuple(
        Goal(arm, turn.goal, turn.start_s, turn.end_s, failed(turn.goal))
        for turn in turns_of(trial)
        for arm in ([turn.arm] if turn.arm is not None else trial.about["arms"])
    )


def contact_of(collision: Mapping[str, Any]) -> Contact:
    """Return a collision of a trial as a replay shows it."""
    arm, what = collision["arm"], collision["what"]
    return Contact(
        collision["time_s"],
        collision["end_s"],
        (f"{arm}: {what}" if what != "arm" else arm, collision["against"]),
        tuple(collision["p_world_m"]),
        collision["force_n"],
    )


def link_poses(name: str, arm: ArmModel, T_world_base: SE3, joints: NDArray[np.float64]) -> dict[str, SE3]:
    """Return the poses (n,) of the bodies of an arm, named as in the simulator, from joints and jaw (n, 7)."""
    poses = T_world_base @ frames(arm, joints[:, :6])
    found = {f"{name}_link{k}": poses[:, k] for k in range(1, 7)}
    for finger, side in (("left", 0.5), ("right", -0.5)):
        turn = SO3.axis("z", np.pi / 2 + side * joints[:, 6])  # the jaws point along y of frame 6
        found[f"{name}_finger_{finger}"] = poses[:, 6] @ SE3.from_parts(turn)
    return found


def arm_of(values: Mapping[str, Any]) -> ArmModel:
    """Return an arm's model from its ``dataclasses.asdict`` as JSON values.

    Raises:
        InvalidInput: the values do not describe an arm.
    """
    from pydantic import TypeAdapter, ValidationError  # slow to import

    known = {field.name for field in fields(ArmModel)}
    if set(values) != known:
        raise InvalidInput("an arm", f"has {sorted(set(values) ^ known)} too many or too few", "the file is damaged")
    try:
        return TypeAdapter(ArmModel).validate_python(values)
    except ValidationError as error:
        raise InvalidInput("an arm", f"cannot be used ({error.errors()[0]['msg']})", "the file is damaged") from None


def _solid_values(solid: Solid) -> dict[str, Any]:
    return {
        "body": solid.body,
        "shape": solid.shape,
        "size_m": list(solid.size_m),
        "T_body_solid": solid.T_body_solid.matrix.tolist(),
        "rgba": list(solid.rgba),
        "vertices_m": np.round(solid.vertices_m, 9).tolist(),
    }


def _solid_of(values: Mapping[str, Any]) -> Solid:
    return Solid(
        str(values["body"]),
        str(values["shape"]),
        tuple(values["size_m"]),
        SE3(np.array(values["T_body_solid"], dtype=np.float64)),
        tuple(values["rgba"]),
        np.array(values["vertices_m"], dtype=np.float64).reshape(-1, 3),
    )


def _pose_values(poses: Mapping[str, SE3]) -> dict[str, Any]:
    return {name: T.matrix.tolist() for name, T in poses.items()}


def _poses_of(values: Mapping[str, Any]) -> dict[str, SE3]:
    return {name: SE3(np.array(matrix, dtype=np.float64)) for name, matrix in values.items()}
