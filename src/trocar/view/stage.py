"""A replay in a viser scene, at any of its frames: bodies, paths, contacts, names of arms; light and camera."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trocar.replay import Replay
from trocar.view.bodies import Bodies
from trocar.view.contacts import Contacts
from trocar.view.film import Film
from trocar.view.labels import ArmLabels
from trocar.view.palette import HORIZON, SKY
from trocar.view.paths import Paths
from trocar.view.viewpoint import FIELD_RAD, Viewpoint, viewpoint

if TYPE_CHECKING:
    from viser import SceneApi, ViserServer

LAMP = (-0.9, 1.6, 3.6)
"""Position of the lamp that casts shadows: right, front and up from the workspace's middle, in its radii."""

LIT = 3.0  # radii of the workspace that the lamp reaches


class Stage:
    """Everything that is drawn of a replay.

    Attributes:
        film: its frames.
        bodies: its bodies.
        viewpoint: of the initial view.
    """

    def __init__(self, server: ViserServer, replay: Replay, film: Film) -> None:
        """Draw a replay at its first frame."""
        self.film = film
        self.viewpoint = viewpoint(replay, film)
        look_from(server, self.viewpoint)
        light(server.scene, self.viewpoint)
        self.bodies = Bodies(server.scene, replay, film)
        ball_m = 0.035 * self.viewpoint.radius_m
        self._moments = (
            Paths(server.scene, replay, film),
            Contacts(server.scene, replay, film, ball_m),
            ArmLabels(server.scene, replay, film, 0.4 * self.viewpoint.radius_m),
        )

    def show(self, frame: int) -> None:
        """Show a frame, whatever was shown before."""
        self.bodies.show(frame)
        self.show_moments(frame)

    def show_moments(self, frame: int) -> None:
        """Show paths, contacts and labels of a frame, not its bodies."""
        for moment in self._moments:
            moment.show(frame)


def look_from(server: ViserServer, view: Viewpoint) -> None:
    """Set the initial view of the page."""
    camera = server.initial_camera
    camera.position, camera.look_at, camera.up = view.eye_m, view.centre_m, (0.0, 0.0, 1.0)
    camera.fov = FIELD_RAD
    camera.near = 0.02 * float(np.linalg.norm(view.eye_m - view.centre_m))


def light(scene: SceneApi, view: Viewpoint) -> None:
    """Light a scene like a photo studio: one lamp that casts shadows, and a plain background.

    viser's own lamps are made for scenes of metres: their shadows begin centimetres behind the object that casts them.
    """
    scene.configure_default_lights(False)
    scene.configure_environment_map("studio", environment_intensity=0.3)
    scene.add_light_hemisphere("/light/sky", intensity=0.2, ground_color=(150, 150, 155))
    along, front, up = LAMP
    offset = view.radius_m * (along * view.right + front * view.front + up * np.array([0.0, 0.0, 1.0]))
    scene.add_light_spot(
        "/light/lamp",
        position=tuple((view.centre_m + offset).tolist()),
        direction=tuple((-offset).tolist()),
        intensity=1.4,
        angle=math.atan(LIT * view.radius_m / float(np.linalg.norm(offset))),
        penumbra=1.0,
        decay=0.0,
        cast_shadow=True,
    )
    height = np.linspace(0.0, 1.0, 128)[:, None, None]
    scene.set_background_image(np.tile((1 - height) * SKY + height * HORIZON, (1, 4, 1)).astype(np.uint8), "png")
