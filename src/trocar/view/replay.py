"""A trial as one file that any browser plays, without a network: ``replay.html``."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trocar.files.output import write_text
from trocar.replay import Replay
from trocar.view.film import FRAME_RATES, Film, shoot
from trocar.view.server import LOOK, close_server, open_server
from trocar.view.stage import CONTACT, Bodies, Rgb, Stage, arm_colours, css

if TYPE_CHECKING:
    from viser.infra import StateSerializer


POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob: data:; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src data: blob:; worker-src blob: data:; font-src data:"
)
"""Security policy: the browser lets the page load only its own content."""

STYLE = """
#trocar { position: fixed; inset: auto auto 40px 0; z-index: 1; margin: 10px; padding: 5px 12px;
  display: flex; flex-wrap: wrap; align-items: baseline; gap: 0 20px;
  max-width: calc(100vw - 20px); border-radius: 6px; background: rgb(255 255 255 / 82%); pointer-events: none;
  font: 13px/1.5 system-ui, "Segoe UI", Roboto, Helvetica, Arial, sans-serif; color: #22262b; }
#trocar h1 { font-size: 16px; font-weight: 600; margin: 0; }
#trocar ul { list-style: none; margin: 0; padding: 0; display: flex; flex-wrap: wrap; gap: 0 16px; }
#trocar i { display: inline-block; vertical-align: middle; margin-right: 6px; }
#trocar i.line { width: 22px; height: 0; border-top: 4px solid; }
#trocar i.dashed { width: 22px; height: 0; border-top: 2px dashed; }
#trocar i.ball { width: 11px; height: 11px; border-radius: 50%; }
#trocar p { margin: 0; font-size: 12px; }
#trocar p, #trocar i { color: #59606a; }
[data-mantine-color-scheme="dark"] #trocar { background: rgb(26 29 33 / 82%); color: #e6e9ec; }
[data-mantine-color-scheme="dark"] #trocar :is(p, i) { color: #a3adb8; }
"""

BEGIN = """
const begin = () => {
  const [, given] = location.hash.match(/^#t=(\\d+(?:\\.\\d+)?)$/) ?? [];
  if (given === undefined) return;
  const field = document.querySelector(".mantine-NumberInput-input");
  const thumb = document.querySelector(".mantine-Slider-thumb");
  if (!field || !thumb) return setTimeout(begin, 100);  // the player is not there yet
  const time = Math.min(Number(given), thumb.getAttribute("aria-valuemax") - 0.1);
  Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(field, time.toFixed(2));
  field.dispatchEvent(new Event("input", { bubbles: true }));
  setTimeout(() => {
    if (Math.abs(thumb.getAttribute("aria-valuenow") - time) > 0.02) return begin();
    const play = field.closest(".mantine-Paper-root").querySelector("button");  // a time that is typed stops it
    goOn(() => play.click(), performance.now() + 3000, performance.now(), 5);
  }, 100);
};
const goOn = (play, latest, before, smooth) => requestAnimationFrame((now) => {  // once the scene is built
  if (!smooth || now > latest) return play();
  goOn(play, latest, now, now - before < 100 ? smooth - 1 : 5);
});
addEventListener("hashchange", begin);
begin();
"""
"""Starts the player at the time in the page's address: viser's player has no such option, so this types the time."""

LARGEST_BYTES = 3_000_000
MAX_POSES = 40_000  # limit of pose changes in such a page; a longer trial gets fewer frames per second
END_S = 1.0  # pause before the player starts again after its last frame


def write_replay(replay: Replay, path: str | Path) -> Path:
    """Write a page that plays a replay in 3D, and return its path.

    The page contains everything that it needs and loads nothing from a network. It plays 30 frames per second of the
    trial's clock, or a lower rate of ``FRAME_RATES`` to keep to ``MAX_POSES`` changes of poses and, if possible, to
    ``LARGEST_BYTES``. Each frame shows a recorded tick; nothing is interpolated. A body is moved once it is more than
    20 um or 0.1 mrad from where it is drawn. With ``#t=SECONDS`` at the end of its address it starts at that time.

    Args:
        replay: what is played.
        path: of the page; an existing file is replaced.

    Raises:
        TrocarError: viser is not installed, the replay does not fit together, or the file cannot be written.
    """
    page = ""
    for share in (1, 2, 4):  # from fine to coarse, until the page is small enough
        film = shoot(replay, FRAME_RATES, MAX_POSES // share)
        page = _with_overlay(_recorded(replay, film), replay, film)
        if len(page.encode()) <= LARGEST_BYTES:
            break
    return write_text(path, page, "replay")


def _recorded(replay: Replay, film: Film) -> str:
    """Return viser's own page of a film, recorded on a temporary server that only this machine can reach."""
    server = open_server(0)
    try:
        with server.atomic():  # so that messages do not each wake a thread
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


def notice(replay: Replay) -> str:
    """Return the text beside a scene: whether it was simulated (then true joints are known), and a warning."""
    known = not replay.joints or any("true" in kinds for kinds in replay.joints.values())
    return f"{'Simulated. ' if known else ''}For research, not for use on patients."


def _with_overlay(page: str, replay: Replay, film: Film) -> str:
    """Return viser's page with the replay's title and legend over it, our look, and without network access."""
    arms = [_entry("line", colour, escape(arm)) for arm, colour in arm_colours(replay).items()]
    kinds = [_entry("dashed", None, "tip, planned"), _entry("line", None, "tip, driven")]
    contact = [_entry("ball", CONTACT, "contact")]
    entries = [*arms, *(kinds if arms else []), *(contact if replay.contacts else [])]
    title = escape(replay.title)
    block = (
        f'<div id="trocar"><h1>{title}</h1><ul>{"".join(entries)}</ul>'
        f"<p>{notice(replay)} {film.rate_hz:g} frames per second.</p></div>{LOOK}<script>{BEGIN}</script>"
    )
    page = page.replace("<title>Viser</title>", f"<title>{title}</title>", 1)
    page = page.replace("<head>", f'<head><meta http-equiv="Content-Security-Policy" content="{POLICY}">', 1)
    page = page.replace("</head>", f"<style>{STYLE}</style></head>", 1)
    return page.replace("</body>", f"{block}</body>", 1)


def _entry(kind: str, colour: Rgb | None, name: str) -> str:
    """Return an entry of the legend; without a colour, in that of quiet text."""
    where = "background" if kind == "ball" else "border-color"
    style = "" if colour is None else f' style="{where}: {css(colour)}"'
    return f'<li><i class="{kind}"{style}></i>{name}</li>'
