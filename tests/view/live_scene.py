"""A made-up cell for live pages: its moments are ticks of the made-up replay."""

from __future__ import annotations

import time
from functools import cache
from types import MappingProxyType

import msgspec.msgpack
import numpy as np
import viser
import zstandard
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from made_up_replay import made_up_replay
from trocar.replay import Replay, ToolPath
from trocar.view.console_view import ConsoleMoment, Standing
from trocar.view.live import ArmFacts, Moment

REPLAY = cache(lambda: made_up_replay(6.0))


class MadeUpScene:
    """Replays the rows that ``tick`` names."""

    def shown(self, title, times_s, arrays, planned="desired"):
        whole, ticks = REPLAY(), arrays["tick"].ravel()
        kinds = ("commanded", "measured", "true")
        return Replay(
            title,
            times_s,
            whole.solids,
            {body: T if T.matrix.ndim == 2 else T[ticks] for body, T in whole.T_world_body.items()},
            {a: ToolPath(p.p_world_planned_m[ticks], p.p_world_driven_m[ticks]) for a, p in whole.tools.items()},
            joints={arm: {kind: of[kind][ticks] for kind in kinds} for arm, of in whole.joints.items()},
            joint_names=whole.joint_names,
        )


def moment(tick, state="ENABLED", **more):
    """Return the moment of a tick; both arms are in a state."""
    facts = {"commanded by": "<nobody>"}
    arms = {arm: ArmFacts(state, "homed", facts) for arm in REPLAY().tools}
    return Moment(tick / 100, {"tick": np.array([[tick]])}, arms, "no tick was late", **more)


def console_moment(tick, flaws=MappingProxyType({}), **standing):
    """Return the moment of a tick, with the console's state."""
    now = moment(tick)
    return ConsoleMoment(now.time_s, now.arrays, standing=Standing(**{"words": "Runs", **standing}), flaws=flaws)


def until(found, limit_s=60.0):
    """Wait until something is found, and return it."""
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        if result := found():
            return result
        time.sleep(0.01)
    raise TimeoutError("it does not come to that")


def messages(port, limit_s=60.0):
    """Yield the messages of a page of viser's, as a browser gets them; fail after a time."""
    end_s, protocol = time.monotonic() + limit_s, Subprotocol(f"viser-v{viser.__version__}")
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None, proxy=None) as socket:
        while time.monotonic() < end_s:
            packed = socket.recv(timeout=limit_s)
            inner = zstandard.ZstdDecompressor().decompress(packed[16 : 16 + int.from_bytes(packed[8:16], "little")])
            yield from msgspec.msgpack.decode(inner)["messages"]
    raise AssertionError("it never came")
