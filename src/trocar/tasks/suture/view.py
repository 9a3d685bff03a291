"""A suture plan in the browser: arm, needle and tissue in three dimensions, with a slider along the primitive."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, ik_unbounded
from trocar.errors import InvalidValue, OutOfReach
from trocar.geometry import SE3, SO3, TURN
from trocar.report.style import PATHS
from trocar.tasks.suture.planning import DexterityMap, Needle, Suture, SuturePlan, sutures_at
from trocar.tasks.suture.planning.primitive import ROLL, needle_poses, steps, tip_poses, unwound
from trocar.tasks.suture.report.circle import texture
from trocar.view.instrument import Instrument, put
from trocar.view.mesh import Mesh, tube
from trocar.view.server import close_server, open_server

GOLD, TISSUE, INK = (214, 150, 30), (222, 150, 135), (60, 60, 60)
OPEN_RAD = math.radians(40.0)
"""Opening of the jaws while they move back along the needle; for drawing only."""
LABEL_M = 0.004  # distance of an arrow's number from the middle of the arrow, outwards
FRAMES_A_STEP, FRAMES_PER_S = 16, 12.0


@dataclass(frozen=True, eq=False)
class SutureMotion:
    """A suture as a sequence of frames to draw.

    Attributes:
        arm: the arm.
        step: (k,) name of the primitive's step in each frame.
        q: (k, 6) joints, rad and m.
        T_world_tip: (k,) pose of the arm's tip that the primitive asks for.
        T_world_needle: (k,) pose of the needle.
        opening_rad: (k,) opening of the jaws.
    """

    arm: ArmModel
    step: tuple[str, ...]
    q: NDArray[np.float64]
    T_world_tip: SE3
    T_world_needle: SE3
    opening_rad: NDArray[np.float64]

    def joint_table(self, place: int) -> str:
        """Return the joints at one frame as a Markdown table: value, range, distance to the nearer limit."""
        rows = ["| joint | value | range | to limit |", "|:--|--:|:-:|--:|"]
        for joint, value in zip(self.arm.joints, self.q[place].tolist(), strict=True):
            scale, name = joint.shown_scale[0], joint.name.replace("_", " ")
            left = scale * min(value - joint.lower, joint.upper - value)
            to_limit = f"{left:.0f}" if left >= 0 else f"**{left:.0f} outside**"
            limits = f"{scale * joint.lower:.0f} to {scale * joint.upper:.0f}"
            rows.append(f"| {name} | {joint.shown(value)} | {limits} | {to_limit} |")
        return "\n".join(rows)


def suture_motion(suture: Suture) -> SutureMotion:
    """Return one suture frame by frame along the steps of the primitive.

    Raises:
        OutOfReach: the arm has no solution for part of it.
    """
    setup, movements = suture.setup, steps(suture.setup)
    ends = np.array([(step.advance_m, step.jaws_rad, step.needle_rad) for step in movements])
    advance, jaws, needle = np.linspace(ends[..., 0], ends[..., 1], FRAMES_A_STEP, axis=1).reshape(-1, 3).T
    T_world_tip = setup.circle.T_world_circle @ suture.turned(tip_poses(setup, advance, jaws))
    q = ik_unbounded(setup.arm, setup.T_world_base.inverse() @ T_world_tip)
    if not np.isfinite(q).all():
        raise OutOfReach(
            f"the suture at {suture} cannot be drawn: arm '{setup.arm.name}' cannot point its instrument there; move "
            "the circle or the base",
            arm=setup.arm.name,
        )
    q[:, ROLL] = unwound(q[:, ROLL], setup.arm.middle_floats[ROLL])
    return SutureMotion(
        setup.arm,
        tuple(step.name for step in movements for _ in range(FRAMES_A_STEP)),
        q,
        T_world_tip,
        setup.circle.T_world_circle @ suture.turned(needle_poses(setup, advance, needle)),
        np.repeat([0.0 if step.holds else OPEN_RAD for step in movements], FRAMES_A_STEP),
    )


class PlanView:
    """A plan drawn in a browser, with a menu of its sutures and a slider along the needle primitive.

    Lengths are in metres, in the world's frame, z up. Nodes of the scene: ``/circle`` (tissue, rim, arrows, rings; in
    its frame), ``/needle``, and ``/arm`` with the instrument.

    Attributes:
        server: the viser server.
        sutures: entries of the menu.
        motions: the sutures, frame by frame.
    """

    def __init__(self, map: DexterityMap, plan: SuturePlan, port: int = 8080) -> None:
        """Draw a plan and serve it at this port; if it is taken, at the next free one.

        Raises:
            NotInstalled: viser is not installed.
            OutOfReach: the arm has no solution for a suture.
        """
        self.map, self.plan, self.setup = map, plan, map.setup
        planned = sutures_at(map.setup, plan.positions_rad, plan.directions)
        self.motions = [suture_motion(suture) for suture in planned]
        self.sutures = tuple(f"{number}: {suture}" for number, suture in enumerate(planned, start=1))
        self.server = open_server(port)
        self._draw_circle(planned)
        self._draw_arm()
        self._add_controls()
        self.show(0, 0)
        eye, aim = self._eye()

        @self.server.on_client_connect
        def look(client: Any) -> None:
            client.camera.position, client.camera.look_at = tuple(eye.tolist()), tuple(aim.tolist())

    @property
    def port(self) -> int:
        """Return the port of the server."""
        return self.server.get_port()

    def show(self, number: int, place: int) -> None:
        """Show a suture of the plan, counted from 0, at one of its frames; menu and slider follow.

        Raises:
            InvalidValue: there is no such suture or frame.
        """
        for what, value, count in (("suture", number, len(self.motions)), ("frame", place, len(self.motions[0].q))):
            if not 0 <= value < count:
                raise InvalidValue(f"the number of the {what}", value, f"give 0 to {count - 1}")
        self._menu.value, self._slider.value = self.sutures[number], place
        self._draw(number, place)

    def play(self) -> None:
        """Show the frames one after another while the box is ticked; ends with Ctrl-C."""
        while True:
            time.sleep(1.0 / FRAMES_PER_S)
            if self._play.value:
                self._slider.value = (self._slider.value + 1) % len(self.motions[0].q)

    def close(self) -> None:
        """Stop serving."""
        close_server(self.server)

    def _draw(self, number: int, place: int) -> None:
        """Update needle, arm and text."""
        motion = self.motions[number]
        with self.server.atomic():
            put(self._needle, motion.T_world_needle[place])
            self._instrument.show(self.setup.T_world_base, motion.q[place], motion.opening_rad[place])
            reward = self.plan.rewards[number]
            self._text.content = f"Reward {reward:.3f}. Step: **{motion.step[place]}**\n\n{motion.joint_table(place)}"

    def _draw_circle(self, planned: tuple[Suture, ...]) -> None:
        """Draw tissue and rim and, on them, arrows and rings coloured by reward."""
        circle, scene = self.setup.circle, self.server.scene
        T = circle.T_world_circle
        scene.add_frame("/circle", show_axes=False, wxyz=T.rotation.as_quaternion(), position=T.translation_m)
        rgba, side_m = texture(self.map, self.plan)
        wide = max(1.9 * circle.radius_m, 0.53 * side_m)
        self._add("/circle/tissue", tube([[0, 0, -1e-3], [0, 0, 0]], wide, 64), TISSUE, opacity=0.8)
        turn = np.linspace(0.0, TURN, 181)
        rim = circle.radius_m * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1) + [0.0, 0.0, 2e-4]
        self._add("/circle/rim", tube(rim, 3e-4, 8), INK)
        above = (0.0, 0.0, 6e-4)  # above tissue and rim; an image, because a mesh would be shaded
        scene.add_image("/circle/rewards", rgba, side_m, side_m, format="png", position=above)
        for number, suture in enumerate(planned, start=1):
            middle = suture.ends_m.mean(0)
            beside = middle * (1 + LABEL_M / float(np.linalg.norm(middle)))
            scene.add_label(f"/circle/label_{number}", f"{number}", position=(*beside.tolist(), 1e-3))

    def _draw_arm(self) -> None:
        """Add remote centre, instrument and needle to the scene; ``show`` places them."""
        scene = self.server.scene
        centre = tuple(self.setup.T_world_base.translation_m.tolist())
        scene.add_icosphere("/remote_centre", radius=0.004, color=GOLD, position=centre)
        scene.add_label("/remote_centre/label", "remote centre")
        self._instrument = Instrument(scene, "/arm", self.setup.arm)
        self._needle = self._add("/needle", needle_mesh(self.setup.needle), GOLD)

    def _add_controls(self) -> None:
        """Add the menu, the slider and the text."""
        gui, (low, high) = self.server.gui, self.map.span(self.plan.rewards)
        gui.add_markdown(
            f"Reward of the worst suture: **{self.plan.reward:.3f}**; {self.plan.certified}.\n\n"
            f"Colours: {low:.2f} to {high:.2f}. Outer ring: clockwise sutures, inner ring: counterclockwise ones, "
            "hatched: cannot be driven"
        )
        colours = mpl.colormaps[PATHS](np.linspace(0.0, 1.0, 256), bytes=True)[None, :, :3]
        gui.add_image(np.tile(colours, (16, 1, 1)), format="png")
        self._menu = gui.add_dropdown("suture", self.sutures)
        self._slider = gui.add_slider("along it", 0, len(self.motions[0].q) - 1, 1, 0)
        self._play = gui.add_checkbox("play", False)
        self._text = gui.add_markdown("")

        def chosen(_: Any) -> None:
            self._draw(self.sutures.index(self._menu.value), self._slider.value)

        self._menu.on_update(chosen)
        self._slider.on_update(chosen)

    def _eye(self) -> NDArray[np.float64]:
        """Return the camera's position and target (2, 3): beside the arm, so that the arm hides little."""
        circle = self.setup.circle
        x, y, _ = self.setup.T_base_circle.inverse().translation_m
        beside = SO3.axis("z", math.atan2(y, x) + math.radians(115.0)).apply([3.3 * circle.radius_m, 0.0, 0.0])
        high, aim = 2.2 * circle.radius_m, 0.35 * circle.radius_m
        return circle.T_world_circle.apply(np.stack([beside + [0.0, 0.0, high], [0.0, 0.0, aim]]))

    def _add(self, name: str, mesh: Mesh, colour: tuple[int, int, int], **how: Any) -> Any:
        return self.server.scene.add_mesh_simple(name, mesh.vertices_m, mesh.faces, color=colour, **how)


def needle_mesh(needle: Needle) -> Mesh:
    """Return the needle, with a pointed tip, in its own frame."""
    line = needle.point_m(np.linspace(0.0, needle.arc_rad, 49))
    radii = np.full(len(line), needle.wire_m / 2)
    radii[:3] *= [0.05, 0.45, 0.85]
    return tube(line, radii, sides=12)
