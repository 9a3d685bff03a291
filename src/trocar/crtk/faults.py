"""Plant faults in a served robot, to try clients and the doctor with."""

from __future__ import annotations

import math
import random
import time
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar, Unpack

from trocar.crtk.bus import KEPT_UNREAD, Bus, Client, Endpoint, Keeping, Publisher, Subscriber
from trocar.crtk.fault_kinds import KINDS, Change, Place, Value
from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.lab.station import Station
from trocar.lab.topics import Topics

Message = TypeVar("Message")


@dataclass(frozen=True)
class Fault:
    """A fault of one arm.

    Attributes:
        arm: name.
        kind: name in ``KINDS``.
        value: how large.
        at_s: when it begins after the server's start.
    """

    arm: str
    kind: str
    value: Value
    at_s: float = 0.0


def fault_of(text: str, arms: Sequence[str]) -> Fault:
    """Return the fault that ``ARM:KIND[=VALUE][@TIMEs]`` says, such as ``psm1:slow=5@20s``.

    Raises:
        InvalidInput: the text names no fault that can be planted.
    """
    item = f"--fault {text!r}"
    arm, colon, rest = text.partition(":")
    if not colon:
        raise InvalidInput(item, "names no arm or no kind", "write ARM:KIND[=VALUE][@TIMEs], such as psm1:stale@20s")
    rest, _, at = rest.partition("@")
    name, _, given = rest.partition("=")
    if arm not in arms:
        raise UnknownName(f"{item}: arm", arm, arms)
    if name not in KINDS:
        raise UnknownName(f"{item}: kind", name, KINDS)
    kind = KINDS[name]
    at_s = _number(f"the time in {item}", at.removesuffix("s")) if at else 0.0
    if at_s and kind.from_the_start:
        raise InvalidInput(item, f"begins after {at_s:g} s", f"a fault {name!r} is there from the start: leave @ away")
    if given and kind.value is None:
        raise InvalidInput(item, f"has the value {given!r}", f"a fault {name!r} has none")
    if name == "swapped" and len(arms) < 2:
        raise InvalidInput(item, "needs two arms", "choose a station that has them, or another fault")
    if not given or isinstance(kind.value, str):
        return Fault(arm, name, given or kind.value, at_s)
    return Fault(arm, name, _number(f"the value in {item}", given), at_s)


def _number(item: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        raise InvalidValue(item, repr(text), "give a number above 0") from None
    if not 0 < number < math.inf:
        raise InvalidValue(item, text, "give a number above 0")
    return number


class FaultyBus:
    """A bus that publishes what a robot with faults would.

    Args:
        bus: of the server.
        faults: to plant.
        station: whose arms are served.
        topics: their namespaces.
        clock: returns the time, s.
    """

    def __init__(
        self,
        bus: Bus,
        faults: Sequence[Fault],
        station: Station,
        topics: Topics,
        clock: Callable[[], float] = time.monotonic,
    ):
        self._bus, self._faults, self._station, self._topics, self._clock = bus, faults, station, topics, clock
        self._start_s = clock()
        self._begins: list[tuple[float, _Faulty[Any]]] = []

    def publisher(self, topic: str, kind: type[Message], **keeping: Unpack[Keeping]) -> Publisher[Message]:
        """Return a publisher of a topic, with the faults of its arm."""
        topic, latched = self._swapped(topic), keeping.get("latched", False)
        arm, what = self.arm_of(topic)
        faults = [fault for fault in self._faults if fault.arm == arm]
        if arm is None or not faults or "header" not in {one.name for one in fields(kind)}:  # type: ignore[arg-type]
            return self._bus.publisher(topic, kind, **keeping)
        sent_as, planted = kind, []
        for fault in faults:
            known = KINDS[fault.kind]
            change = known.change and known.change(Place(what, fault.value, self._station.arms[arm], self._station))
            if known.kinds and kind in known.kinds:
                sent_as, change = known.kinds[kind]
            planted.append(_Planted(fault, change, None if latched else known.delay_s))
        copies = 2 if any(fault.kind == "twice" for fault in faults) else 1
        publishers = [self._bus.publisher(topic, sent_as, **keeping) for _ in range(copies)]
        faulty = _Faulty(publishers, planted, self._now_s)
        if latched:  # such a topic may be published only once, so it is repeated when a fault begins
            self._begins += [(fault.at_s, faulty) for fault in faults if fault.at_s]
            self._begins.sort(key=lambda one: one[0])
        return faulty

    def subscriber(
        self, topic: str, kind: type[Message], *, latched: bool = False, kept: int = KEPT_UNREAD
    ) -> Subscriber[Message]:
        """Return a subscriber of a topic."""
        return self._bus.subscriber(self._swapped(topic), kind, latched=latched, kept=kept)

    def endpoints(self) -> list[Endpoint]:
        """Return all publishers and subscribers."""
        return self._bus.endpoints()

    def client(self, sender: Hashable) -> Client:
        """Return who a sender is."""
        return self._bus.client(sender)

    def _now_s(self) -> float:
        """Return the time since the start; repeat the latched topics of faults that begin now."""
        now_s = self._clock() - self._start_s
        while self._begins and self._begins[0][0] <= now_s:
            self._begins.pop(0)[1].repeat()
        return now_s

    def arm_of(self, topic: str) -> tuple[str | None, str]:
        """Return the arm of a topic, and the rest of its name."""
        for arm in self._station.arms:
            namespace = f"{self._topics.of_arm(arm)}/"
            if topic.startswith(namespace):
                return arm, topic.removeprefix(namespace)
        return None, topic

    def _swapped(self, topic: str) -> str:
        """Return the topic to use instead: the other arm's, if two arms are swapped."""
        arm, what = self.arm_of(topic)
        arms = list(self._station.arms)
        for fault in self._faults:
            if fault.kind == "swapped":
                pair = fault.arm, arms[(arms.index(fault.arm) + 1) % len(arms)]
                if arm in pair:
                    return f"{self._topics.of_arm(pair[1 - pair.index(arm)])}/{what}"
        return topic


@dataclass(frozen=True)
class _Planted:
    """A fault on one topic."""

    fault: Fault
    change: Change | None
    delay_s: Callable[[Any, random.Random], float] | None


class _Faulty(Publisher[Message]):
    def __init__(self, publishers: Sequence[Publisher[Any]], planted: Sequence[_Planted], clock: Callable[[], float]):
        self._publishers, self._planted, self._clock = publishers, planted, clock
        self._rng, self._last = random.Random(0), None
        self._held: deque[tuple[float, Any]] = deque()

    def send(self, message: Message) -> None:
        self._last, now_s = message, self._clock()
        due_s, changed = now_s, message
        for one in self._planted:
            if now_s >= one.fault.at_s and changed is not None:
                changed = one.change(changed) if one.change else changed
                due_s += one.delay_s(one.fault.value, self._rng) if one.delay_s else 0.0
        if changed is not None:
            self._held.append((max(due_s, self._held[-1][0]) if self._held else due_s, changed))
        while self._held and self._held[0][0] <= now_s:
            _, due = self._held.popleft()
            for publisher in self._publishers:
                publisher.send(due)

    def repeat(self) -> None:
        """Send the last message again."""
        if self._last is not None:
            self.send(self._last)

    def readers(self) -> int:
        return max(publisher.readers() for publisher in self._publishers)
