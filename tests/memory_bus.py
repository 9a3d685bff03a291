"""A bus within one process: every subscriber hears every publisher of its topic and type at once."""

from collections import defaultdict

from trocar.crtk.bus import KEPT_UNREAD, Client, Endpoint, Publisher, Subscriber
from trocar.crtk.messages import ros_name


class MemoryBus:
    """The bus of one participant, ``node``; it hears everybody who shares its ``wire``."""

    def __init__(self, wire=None, node="/robot", address="127.0.0.1"):
        self.wire = Wire() if wire is None else wire
        self.node, self.address = node, address

    def publisher(self, topic, kind, *, latched=False, kept_s=None, kept=None):
        self.wire.endpoints.append(Endpoint(topic, ros_name(kind), True, self.client(self)))
        return _Out(self, topic, kind, latched)

    def subscriber(self, topic, kind, *, latched=False, kept=KEPT_UNREAD):
        self.wire.endpoints.append(Endpoint(topic, ros_name(kind), False, self.client(self)))
        made = _In(kept)
        self.wire.subscribers[topic, kind].append(made)
        made.unread += [(0.0, *self.wire.latched[topic, kind])] if (topic, kind) in self.wire.latched else []
        return made

    def endpoints(self):
        return list(self.wire.endpoints)

    def client(self, sender):
        return Client(sender.node, (sender.address,), "1")


class Wire:
    def __init__(self):
        self.endpoints, self.subscribers, self.latched = [], defaultdict(list), {}


class _Out(Publisher):
    def __init__(self, bus, topic, kind, latched):
        self._bus, self._key, self._latched = bus, (topic, kind), latched

    def send(self, message):
        if self._latched:
            self._bus.wire.latched[self._key] = (self._bus, message)
        for one in self._bus.wire.subscribers[self._key]:
            one.unread.append((0.0, self._bus, message))

    def readers(self):
        return len(self._bus.wire.subscribers[self._key])


class _In(Subscriber):
    def __init__(self, kept):
        super().__init__()
        self._kept, self.unread = kept, []

    def senders(self):
        return 1

    def _come(self):
        come, self.unread = self.unread[-self._kept :], []
        return come
