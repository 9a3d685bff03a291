"""What was heard of one arm, as arrays, for the checks of ``trocar crtk doctor``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.crtk.convert import place_of, seconds
from trocar.crtk.dialect import joints_in
from trocar.crtk.explaining import Explanation, explain
from trocar.crtk.listening import Heard, Message, Wanted, published_by
from trocar.geometry import SE3
from trocar.lab.station import Station
from trocar.lab.topics import Topics


@dataclass(frozen=True)
class Finding:
    """Result of a check: whether all is well (None: unknown), the value found, and the remedy."""

    well: bool | None
    found: str
    remedy: str = ""


@dataclass
class ArmHeard:
    """What was heard of one arm, as arrays.

    Attributes:
        arm: name.
        station: of the arm.
        topics: of the station.
        heard: everything that was heard.
        failed: names of the checks so far that did not pass.
    """

    arm: str
    station: Station
    topics: Topics
    heard: Heard
    failed: set[str] = field(default_factory=set)

    @property
    def topic(self) -> str:
        """Return the arm's namespace."""
        return self.topics.of_arm(self.arm)

    @cached_property
    def wanted(self) -> Mapping[str, Wanted]:
        """Return the topics that the arm should publish."""
        return published_by(self.arm, self.topics)

    @cached_property
    def come(self) -> dict[str, list[Message]]:
        """Return the messages of each topic that is not latched, if any came."""
        found = {topic: list(self.heard.messages[topic]) for topic, one in self.wanted.items() if not one.latched}
        return {topic: messages for topic, messages in found.items() if messages}

    @cached_property
    def streams(self) -> dict[str, list[Message]]:
        """Return the messages of each topic that is not latched, if at least two came."""
        return {topic: messages for topic, messages in self.come.items() if len(messages) > 1}

    @cached_property
    def ages(self) -> dict[str, NDArray[np.float64]]:
        """Return the times (s) from stamp to arrival, by topic, without messages that may have waited unseen."""
        return {
            topic: np.array(
                [at_s - seconds(one.header.stamp) for at_s, one in messages if at_s not in self.heard.blind_s]
            )
            for topic, messages in self.streams.items()
        }

    def last(self, what: str) -> Any:
        """Return the last message of a topic; None: none came."""
        messages = self.heard.messages[f"{self.topic}/{what}"]
        return messages[-1][1] if messages else None

    def joints(self, what: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return stamps (n,), s, and joints (n, 6) of a topic's messages that are valid and finite."""
        messages = [message for _, message in self.streams.get(f"{self.topic}/{what}", [])]
        rows = [(seconds(one.header.stamp), joints_in(self.topics.dialect, one)) for one in messages]
        rows = [(stamp_s, q) for stamp_s, q in rows if np.isfinite(q).all()]
        return np.array([stamp_s for stamp_s, _ in rows]), np.array([q for _, q in rows]).reshape(-1, 6)

    def poses(self, what: str) -> tuple[NDArray[np.float64], SE3]:
        """Return stamps (n,), s, and poses (n,) of a topic's valid messages."""
        messages = [message for _, message in self.streams.get(f"{self.topic}/{what}", [])]
        rows = [(seconds(one.header.stamp), T) for one in messages if (T := place_of(one)) is not None]
        matrices = np.array([T.matrix for _, T in rows]).reshape(-1, 4, 4)
        return np.array([stamp_s for stamp_s, _ in rows]), SE3.unchecked(matrices)

    @cached_property
    def explained(self) -> Explanation | None:
        """Return how the arm's poses differ from those of its joints, and why; None: nothing to compare."""
        stamps_s, q = self.joints("measured_js")
        at_s, T = self.poses("local/measured_cp")
        if len(stamps_s) == 0 or len(at_s) == 0 or "finite" in self.failed:
            return None
        at = np.stack([np.interp(at_s, stamps_s, column) for column in q.T], axis=1)
        return explain(self.station.arms[self.arm].model, at, T)

    def after(self, *names: str) -> Finding | None:
        """Return why a check cannot be made, if one of these did not pass."""
        wrong = [name for name in names if name in self.failed]
        return Finding(None, f"cannot be told: see {wrong[0]}") if wrong else None
