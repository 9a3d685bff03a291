"""Input devices: any device or program moves a console's arms by JSON lines over TCP on this machine."""

from __future__ import annotations

import json
import queue
import re
import socketserver
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from trocar.errors import InvalidInput, InvalidValue
from trocar.view.wishes import Held, Said, Wish

LOCAL = "127.0.0.1"
WISHES = {
    wish.name.lower(): wish for wish in (Wish.TAKE, Wish.RETURN, Wish.STOP, Wish.GO_ON, Wish.EMERGENCY, Wish.DONE)
}
"""Wishes that a line may ask for by name."""
OF_ARM = ("take", "return")
MAX_SCALE, MAX_NUMBER = 10.0, 1e6
HTTP = re.compile(rb"[A-Z]+ \S+ HTTP/")


class Inputs:
    """A server for input devices and other programs on this machine; a context manager.

    A line is a JSON object. ``arm`` names an arm. ``held`` is whether the device moves the arm now. If so, ``position``
    (3 numbers, m) and ``quaternion`` (x, y, z, w; without it the orientation is locked) are the device's pose along the
    world's axes, of which only changes since the arm was first held count; ``scale`` multiplies displacements (default
    1). ``jaw`` runs from 0 (close) to 1 (open). ``wish`` is one of ``WISHES``. While an arm is held, a line must come
    every 0.3 s; otherwise, or if the connection ends, the arm is released. Each line is answered by ``time_s``,
    ``arms`` (position, quaternion, jaw in rad, held) and ``words``, or by ``error``, a sentence.

    Args:
        port: of the server; 0: any free one.
        state: returns the answer.

    Raises:
        InvalidValue: the port is not available.

    Attributes:
        port: of the server.
    """

    def __init__(self, port: int, state: Callable[[], Mapping[str, Any]]):
        self._said: queue.SimpleQueue[Said] = queue.SimpleQueue()
        try:
            self._server = _Server(port, self._said, state)
        except OSError as error:
            raise InvalidValue("--devices", port, f"{error.strerror or error}; give another port, or 0") from None
        self.port = self._server.server_address[1]

    def __enter__(self) -> Inputs:
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    def said(self) -> list[Said]:
        """Return the wishes since the last call."""
        return [self._said.get() for _ in range(self._said.qsize())]


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address, daemon_threads = True, True

    def __init__(self, port: int, said: queue.SimpleQueue[Said], state: Callable[[], Mapping[str, Any]]):
        super().__init__((LOCAL, port), _Device)
        self.said, self.state = said, state


class _Device(socketserver.StreamRequestHandler):
    """One connection."""

    server: _Server  # type: ignore[reportIncompatibleVariableOverride]

    def handle(self) -> None:
        """Pass on lines until the device disconnects; then release the arms that it held."""
        source, held = f"{self.client_address}", set[str]()
        try:
            for line in self.rfile:
                if HTTP.match(line):  # a browser: any website may have sent the request
                    return
                try:
                    answer: Mapping[str, Any] = self.server.state()
                    for said in wishes_of(line, source, answer["arms"]):
                        held |= {said.arm} if said.wish is Wish.HOLD else set()
                        self.server.said.put(said)
                except InvalidInput as error:
                    answer = {"error": str(error)}
                self.wfile.write(json.dumps(answer).encode() + b"\n")
        except OSError:
            pass  # the device has gone
        finally:
            for arm in held:
                self.server.said.put(Said(Wish.RELEASE, arm, source=source))


def wishes_of(line: bytes, source: str, arms: Mapping[str, Any]) -> list[Said]:
    """Return the wishes in a line.

    Raises:
        InvalidInput: the line is not an object as ``Inputs`` describes it.
    """
    now_s = time.monotonic()
    try:
        given = json.loads(line)
    except (ValueError, RecursionError):
        raise InvalidInput("a line", "is no JSON", 'send {"arm": "psm1", "held": true, ...}') from None
    if not isinstance(given, dict):
        raise InvalidInput("a line", "is no JSON object", 'send {"arm": "psm1", "held": true, ...}')
    arm, found = given.get("arm", ""), []
    if not isinstance(arm, str) or arm not in ("", *arms):
        remedy = f"name one of {', '.join(arms)}" if arms else "wait until the trial has begun"
        raise InvalidInput("arm", f"is {arm!r}", remedy)
    if not arm and ({"held", "jaw"} & given.keys() or given.get("wish") in OF_ARM):
        raise InvalidInput("a line", "names no arm", f"give arm: {', '.join(arms)}")
    if "wish" in given:
        if not isinstance(given["wish"], str) or given["wish"] not in WISHES:
            raise InvalidInput("wish", f"is {given['wish']!r}", f"give one of {', '.join(WISHES)}")
        found.append(Said(WISHES[given["wish"]], arm, at_s=now_s, source=source))
    if given.get("held"):
        position = _numbers("position", given.get("position"), 3)
        turns, scale = "quaternion" in given, _numbers("scale", [given.get("scale", 1.0)], 1)[0]
        if not 0 < scale <= MAX_SCALE:
            raise InvalidValue("scale", scale, f"give a number above 0, up to {MAX_SCALE:g}")
        turn = _numbers("quaternion", given["quaternion"], 4) if turns else np.array([0.0, 0.0, 0.0, 1.0])
        if np.linalg.norm(turn) < 1e-6:
            raise InvalidInput("quaternion", "is all 0", "give x, y, z, w of an orientation")
        found.append(Said(Wish.HOLD, arm, Held(position, turn[[3, 0, 1, 2]], float(scale), turns), now_s, source))
    elif "held" in given:
        found.append(Said(Wish.RELEASE, arm, at_s=now_s, source=source))
    if "jaw" in given:
        share = float(np.clip(_numbers("jaw", [given["jaw"]], 1)[0], 0.0, 1.0))
        found.append(Said(Wish.JAW, arm, share, now_s, source))
    return found


def _numbers(name: str, given: Any, count: int) -> np.ndarray:
    try:
        values = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        values = np.zeros(0)
    if values.shape != (count,) or not (np.abs(values) <= MAX_NUMBER).all():
        remedy = f"give {count} number{'s' * (count > 1)} of at most {MAX_NUMBER:g}"
        raise InvalidInput(name, f"is {given!r}", remedy)
    return values
