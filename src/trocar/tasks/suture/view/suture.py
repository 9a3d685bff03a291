"""A suture plan in the browser: arm, needle and tissue in three dimensions, with a slider along the primitive."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import frames
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3, TURN, shown
from trocar.tasks.suture.planning.drive import Suture
from trocar.tasks.suture.planning.plan import SuturePlan
from trocar.tasks.suture.planning.primitive import tip_end_m
from trocar.tasks.suture.planning.rewards import DexterityMap
from trocar.tasks.suture.planning.setup import DIRECTION_NAMES, SutureSetup
from trocar.tasks.suture.view import needle_shape
from trocar.tasks.suture.view.motion import SutureMotion, suture_motion
from trocar.tasks.suture.view.painting import Scale, paint
from trocar.view import shapes
from trocar.view.mesh import Mesh, tube
from trocar.view.server import close_server, open_server

STEEL, DARK, GOLD, TISSUE, INK = (170, 176, 184), (92, 98, 106), (214, 150, 30), (222, 150, 135), (60, 60, 60)
LABEL_M = 0.004  # distance of an arrow's number from the middle of the arrow, outwards
RINGS = ". Outer ring: clockwise sutures, inner ring: counterclockwise ones, grey: beyond the limits"
FRAMES_PER_S = 12.0


class SutureView:
    """A plan drawn in a browser, with a menu of its sutures and a slider along the needle primitive.

    All lengths are in metres, in the world's frame, z up. Nodes of the scene: ``/circle`` (tissue, rim, arrows and
    rings; in the circle's frame), ``/needle``, and ``/arm/shaft``, ``/arm/wrist``, ``/arm/jaws`` in the arm's frames 4,
    5 and 7.

    Attributes:
        server: the viser server.
        sutures: entries of the menu.
        motions: the sutures, frame by frame.
        scale: colour scale, the same as in ``plan.png``.
        painting: arrows and rings on the tissue.
    """

    def __init__(self, setup: SutureSetup, plan: SuturePlan, map: DexterityMap | None = None, port: int = 8080) -> None:
        """Draw a plan and serve it.

        Args:
            setup: the geometry.
            plan: the plan to draw.
            map: dexterity of all sutures, for two coloured rings round the circle; None: no rings.
            port: port of the server; if it is taken, the next free one.

        Raises:
            TrocarError: viser is not installed, or the arm has no solution for a suture.
        """
        self.setup, self.plan, self.map = setup, plan, map
        planned = zip(plan.positions_rad.tolist(), plan.directions.tolist(), strict=True)
        self._planned = [Suture(setup, theta, direction) for theta, direction in planned]
        self.motions = [suture_motion(suture) for suture in self._planned]
        self.sutures = tuple(_named(i, plan) for i in range(len(self.motions)))
        self.scale = Scale(*(map.span(plan.rewards) if map else (plan.rewards.min(), plan.rewards.max())))
        self._number = 0
        self.server = open_server(port)
        self._draw_circle()
        self._draw_arm()
        self._add_controls()
        self.show(0, 0)

        @self.server.on_client_connect
        def look(client: Any) -> None:
            client.camera.position, client.camera.look_at = (tuple(point.tolist()) for point in self._eye)

    @property
    def motion(self) -> SutureMotion:
        """Return the suture that is currently shown."""
        return self.motions[self._number]

    @property
    def port(self) -> int:
        """Return the port of the server."""
        return self.server.get_port()

    @property
    def _eye(self) -> NDArray[np.float64]:
        """Return the camera's position and target (2, 3): beside the arm, so that the arm hides little."""
        circle = self.setup.circle
        x, y, _ = (self.setup.T_base_circle.inverse()).translation_m
        beside = SO3.axis("z", math.atan2(y, x) + math.radians(115.0)).apply([3.3 * circle.radius_m, 0.0, 0.0])
        high, aim = 2.2 * circle.radius_m, 0.35 * circle.radius_m
        return circle.T_world_circle.apply(np.stack([beside + [0.0, 0.0, high], [0.0, 0.0, aim]]))

    def show(self, number: int, place: int) -> None:
        """Show a suture of the plan, counted from 0, at one of its frames; menu and slider follow.

        Raises:
            TrocarError: there is no such suture or frame.
        """
        for what, value, count in (("suture", number, len(self.motions)), ("frame", place, len(self.motion.q))):
            if not 0 <= value < count:
                raise TrocarError(f"there is no {what} {value}; give 0 to {count - 1}")
        self._menu.value, self._slider.value = self.sutures[number], place
        self._draw(number, place)

    def _draw(self, number: int, place: int) -> None:
        """Update needle, arm and text."""
        self._number = number
        motion = self.motion
        T_world_frame = self.setup.T_world_base @ frames(self.setup.arm, motion.q[place])
        with self.server.atomic():
            _move(self._needle, motion.T_world_needle[place])
            for node, frame in ((self._shaft, 4), (self._wrist, 5), (self._jaws, 7)):
                _move(node, T_world_frame[frame])
            for finger, side in zip(self._fingers, (0.5, -0.5), strict=True):
                turn = SO3.axis("y", -side * motion.opening_rad[place])
                half = SO3.identity() if side > 0 else SO3.axis("z", math.pi)
                _move(finger, SE3.from_parts(turn @ half, [0.0, 0.0, self.setup.arm.tip_length_m]))
            reward = self.plan.rewards[number]
            self._text.content = f"Reward {reward:.3f}. Step: **{motion.step[place]}**\n\n{motion.joint_table(place)}"

    def play(self) -> None:
        """Show the frames one after another while the box is ticked; ends with Ctrl-C."""
        while True:
            time.sleep(1.0 / FRAMES_PER_S)
            if self._play.value:
                self._slider.value = (self._slider.value + 1) % len(self.motion.q)

    def close(self) -> None:
        """Stop serving."""
        close_server(self.server)

    def _draw_circle(self) -> None:
        """Draw tissue and rim and, on them, arrows and rings coloured by reward."""
        circle = self.setup.circle
        T = circle.T_world_circle
        add = self.server.scene.add_frame
        add("/circle", show_axes=False, wxyz=T.rotation.as_quaternion(), position=T.translation_m)
        arrows = np.array([self._arrow_m(suture) for suture in self._planned])
        self.painting = paint(arrows, self.plan.rewards.tolist(), self.scale, self.map)
        wide = max(1.9 * circle.radius_m, 0.53 * self.painting.side_m)
        self._add("/circle/tissue", tube([[0, 0, -1e-3], [0, 0, 0]], wide, 64), TISSUE, opacity=0.8)
        turn = np.linspace(0.0, TURN, 181)
        rim = circle.radius_m * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1) + [0.0, 0.0, 2e-4]
        self._add("/circle/rim", tube(rim, 3e-4, 8), INK)
        self.server.scene.add_image(
            "/circle/rewards",
            self.painting.rgba,
            self.painting.side_m,
            self.painting.side_m,
            format="png",
            position=(0.0, 0.0, 6e-4),  # above tissue and rim, so that it is visible
        )
        for i, (start, end) in enumerate(arrows):
            middle = (start + end) / 2
            beside = middle * (1 + LABEL_M / float(np.linalg.norm(middle)))
            self.server.scene.add_label(f"/circle/label_{i + 1}", f"{i + 1}", position=(*beside.tolist(), 1e-3))

    def _arrow_m(self, suture: Suture) -> NDArray[np.float64]:
        """Return start and end (2, 2) of a suture: its entry, and where its tip comes out or stops in the tissue."""
        heading = SO3.axis("z", suture.theta_rad).apply([0.0, -float(suture.direction), 0.0])
        return (suture.entry_m + np.outer([0.0, tip_end_m(self.setup)], heading))[:, :2]

    def _draw_arm(self) -> None:
        """Add remote centre, shaft, wrist, jaws and needle to the scene; ``show`` places them."""
        base = self.setup.T_world_base
        self.server.scene.add_icosphere(
            "/remote_centre", radius=0.004, color=GOLD, position=tuple(base.translation_m.tolist())
        )
        self.server.scene.add_label("/remote_centre/label", "remote centre")
        self._shaft = self._add("/arm/shaft", shapes.shaft(self.setup.arm), DARK)
        self._wrist = self._add("/arm/wrist", shapes.wrist_link(self.setup.arm), STEEL)
        self._jaws = self.server.scene.add_frame("/arm/jaws", show_axes=False)
        self._fingers = [
            self._add(f"/arm/jaws/{side}", shapes.finger(self.setup.arm), STEEL) for side in ("left", "right")
        ]
        self._needle = self._add("/needle", needle_shape.wire(self.setup.needle), GOLD)

    def _add_controls(self) -> None:
        """Add the menu, the slider and the text."""
        gui = self.server.gui
        gui.add_markdown(
            f"Reward of the worst suture: **{self.plan.reward:.3f}**; {self.plan.certified}.\n\n"
            f"Colours: {self.scale.low:.2f} to {self.scale.high:.2f}{RINGS if self.map else ''}"
        )
        gui.add_image(self.scale.bar(), format="png")
        self._menu = gui.add_dropdown("suture", self.sutures)
        self._slider = gui.add_slider("along it", 0, len(self.motion.q) - 1, 1, 0)
        self._play = gui.add_checkbox("play", False)
        self._text = gui.add_markdown("")

        @self._menu.on_update
        def chosen(_: Any) -> None:
            self._draw(self.sutures.index(self._menu.value), self._slider.value)

        @self._slider.on_update
        def moved(_: Any) -> None:
            self._draw(self.sutures.index(self._menu.value), self._slider.value)

    def _add(self, name: str, mesh: Mesh, colour: tuple[int, int, int], **how: Any) -> Any:
        """Add a mesh to the scene."""
        return self.server.scene.add_mesh_simple(name, mesh.vertices_m, mesh.faces, color=colour, **how)


def show_plan(
    setup: SutureSetup, plan: SuturePlan, map: DexterityMap | None = None, port: int = 8080, block: bool = True
) -> SutureView:
    """Serve a plan to the browser and return the view, whose ``port`` tells where.

    Args:
        setup: the geometry.
        plan: the plan to draw.
        map: dexterity of all sutures, for two coloured rings; None: no rings.
        port: port of the server; if it is taken, the next free one.
        block: whether to serve until Ctrl-C before returning.

    Raises:
        TrocarError: as ``SutureView``.
    """
    view = SutureView(setup, plan, map, port)
    if block:
        try:
            view.play()
        except KeyboardInterrupt:
            view.close()
    return view


def _named(i: int, plan: SuturePlan) -> str:
    """Return the menu entry of a suture: number, position and direction."""
    return f"{i + 1}: {shown(plan.positions_rad[i], 'rad', '.0f')} {DIRECTION_NAMES[int(plan.directions[i])]}"


def _move(node: Any, T: SE3) -> None:
    """Set the pose of a scene node in its parent."""
    node.wxyz, node.position = T.rotation.as_quaternion(), T.translation_m
