"""A trial as one file that any browser plays, without a network: ``replay.html``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trocar.files.output import write_text
from trocar.replay import Replay
from trocar.view.film import FRAME_RATES, Film, shoot
from trocar.view.overlay import with_overlay
from trocar.view.server import close_server, open_server
from trocar.view.stage import Bodies, Stage

if TYPE_CHECKING:
    from viser.infra import StateSerializer

LARGEST_BYTES = 3_000_000
MAX_POSES = 40_000  # so many pose changes fit into such a page; a longer trial gets fewer frames per second
END_S = 1.0  # pause before the player starts again after its last frame


def write_replay(replay: Replay, path: str | Path) -> Path:
    """Write a page that plays a replay in 3D, and return its path.

    The page contains everything that it needs and loads nothing from a network. It plays 30 frames per second of the
    trial's clock or, if more than ``MAX_POSES`` poses would change, the next lower rate of ``FRAME_RATES`` at which
    they do not; each frame shows a recorded tick, nothing is interpolated. A body is moved once it is more than 20 um
    or 0.1 mrad from where it is drawn.

    Args:
        replay: what is played.
        path: of the page; an existing file is replaced.

    Raises:
        TrocarError: viser is not installed, the replay does not fit together, or the file cannot be written.
    """
    page = ""
    for share in (1, 2, 4):  # the finest that is small enough; a coarse one if there is much besides the poses
        film = shoot(replay, FRAME_RATES, MAX_POSES // share)
        page = with_overlay(_recorded(replay, film), replay, film)
        if len(page.encode()) <= LARGEST_BYTES:
            break
    return write_text(path, page, "replay")


def _recorded(replay: Replay, film: Film) -> str:
    """Return viser's own page of a film. The server that this needs answers only this machine, and is stopped again."""
    server = open_server(0)
    try:
        with server.atomic():  # does not wake a thread at each message
            stage = Stage(server, replay, film)
            recording = server.get_scene_serializer()
            for frame, pause_s in enumerate(np.diff(film.times_s).tolist(), 1):
                recording.insert_sleep(pause_s)
                _record_poses(recording, stage.bodies, frame)
                stage.show_moments(frame)
            recording.insert_sleep(END_S)
            return recording.as_html()
    finally:
        close_server(server)


def _record_poses(recording: StateSerializer, bodies: Bodies, frame: int) -> None:
    """Record what has moved at a frame.

    Setting the nodes' poses would do the same, but a node compares each number with the previous one and notifies the
    server; since most messages of a page are poses, it would take three times as long.
    """
    from viser._messages import SetOrientationMessage, SetPositionMessage

    for name, position, wxyz in bodies.moved(frame):
        recording._insert_message(SetPositionMessage(name, tuple(position.tolist())))
        recording._insert_message(SetOrientationMessage(name, tuple(wxyz.tolist())))
