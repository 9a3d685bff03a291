"""Each browser's viewpoint: the initial one, then one that fits the shape of its window."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trocar.replay import Replay
from trocar.view.film import Film
from trocar.view.viewpoint import FIELD_RAD, CameraView, viewpoint

if TYPE_CHECKING:
    from viser import CameraHandle, ClientHandle, ViserServer

TRIES, NEAR_M = 5, 1e-4
"""A viewpoint is sent up to this many times, until the browser's is this near: it may apply the initial one late."""


def look_from(server: ViserServer, view: CameraView) -> None:
    """Set the initial view of the page."""
    camera = server.initial_camera
    camera.position, camera.look_at, camera.up = view.eye_m, view.target_m, (0.0, 0.0, 1.0)
    camera.fov = FIELD_RAD
    camera.near = 0.02 * float(np.linalg.norm(view.eye_m - view.target_m))


def frame_windows(server: ViserServer, replay: Replay, film: Film, *, live: bool) -> None:
    """Give each browser that connects the viewpoint from which the workspace fills its window."""

    @server.on_client_connect
    def come(client: ClientHandle) -> None:
        frame = Framing(replay, film, live)
        client.camera.on_update(frame.aim)
        frame.aim(client.camera)


class Framing:
    """One browser's viewpoint: fitted to its window at each change of size, until the user moves the camera."""

    def __init__(self, replay: Replay, film: Film, live: bool) -> None:
        self._scene, self._live = (replay, film), live
        self._view: CameraView | None = None
        self._size, self._left = (0, 0), TRIES

    def aim(self, camera: CameraHandle) -> None:
        """Compare the browser's viewpoint with the fitted one; send the fitted one if they differ."""
        view, size = self._view, (camera.image_width, camera.image_height)
        there = view is not None and float(np.linalg.norm(camera.position - view.eye_m)) < NEAR_M
        if not there and not self._left:
            return  # the user has moved the camera
        if size != self._size:  # for example once the panel is beside the scene
            view = viewpoint(*self._scene, camera.aspect, live=self._live)
            self._view, self._size, self._left = view, size, TRIES
        elif there:
            self._left = 0
            return
        assert view is not None
        self._left -= 1
        camera.position, camera.look_at = view.eye_m, view.target_m
