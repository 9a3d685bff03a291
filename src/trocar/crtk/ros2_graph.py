"""Publishers and subscribers in a ROS 2 domain, and the clients that they belong to."""

# cyclonedds reads the annotations of these classes, so they are not strings here.
from collections.abc import Hashable
from dataclasses import dataclass, field
from threading import Lock
from typing import TYPE_CHECKING, Any, TypeAlias
from uuid import UUID

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import InstanceState, Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.internal import InvalidSample
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from trocar.crtk.bus import Client, Endpoint

if TYPE_CHECKING:
    sixteen: TypeAlias = list[int]
    sequence = list
else:
    from cyclonedds.idl.types import array, sequence, uint8

    sixteen = array[uint8, 16]

MOST = 10_000
"""Greatest number of endpoints that are read."""
GONE = Client()
HERE = "127.0.0.1"


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common.msg.dds_.Gid_"):
    """Identity of a participant, writer or reader (ROS 2 Iron and later)."""

    data: sixteen = field(default_factory=lambda: [0] * 16)


@dataclass
class NodeEntities(IdlStruct, typename="rmw_dds_common.msg.dds_.NodeEntitiesInfo_"):
    """A node with its readers and writers."""

    node_namespace: str = ""
    node_name: str = ""
    reader_gid_seq: sequence[Gid] = field(default_factory=list)
    writer_gid_seq: sequence[Gid] = field(default_factory=list)


@dataclass
class ParticipantEntities(IdlStruct, typename="rmw_dds_common.msg.dds_.ParticipantEntitiesInfo_"):
    """The nodes of a participant."""

    gid: Gid = field(default_factory=Gid)
    node_entities_info_seq: sequence[NodeEntities] = field(default_factory=list)


class Graph:
    """What a participant has discovered.

    DDS itself tells the participant of each writer, with its machine's addresses and process. ROS 2's nodes tell which
    writers are theirs on the topic ``ros_discovery_info``.
    """

    def __init__(self, participant: DomainParticipant):
        self._participants = _Told(BuiltinDataReader(participant, BuiltinTopicDcpsParticipant))
        self._publications = _Told(BuiltinDataReader(participant, BuiltinTopicDcpsPublication))
        self._subscriptions = _Told(BuiltinDataReader(participant, BuiltinTopicDcpsSubscription))
        latched = Qos(
            Policy.Reliability.Reliable(duration(milliseconds=100)),
            Policy.Durability.TransientLocal,
            Policy.History.KeepAll,  # the topic has no key: to keep the last message would lose most participants
        )
        topic: Any = Topic(participant, "ros_discovery_info", ParticipantEntities)
        self._nodes: Any = DataReader(participant, topic, qos=latched)
        self._node_of: dict[UUID, str] = {}

    def endpoints(self) -> list[Endpoint]:
        """Return all publishers and subscribers discovered so far."""
        clients = self._clients()
        return [
            Endpoint(
                f"/{one.topic_name.removeprefix('rt/')}", _ros_name(one.type_name), publishes, self._whose(one, clients)
            )
            for publishes, told in ((True, self._publications), (False, self._subscriptions))
            for one, is_there in told.so_far().values()
            if is_there and one.topic_name.startswith("rt/")
        ]

    def client(self, sender: Hashable) -> Client:
        """Return the client whose writer has, or had, this handle."""
        found = self._publications.so_far().get(sender)
        return GONE if found is None else self._whose(found[0], self._clients())

    def _whose(self, endpoint: Any, clients: dict[UUID, Client]) -> Client:
        client = clients.get(endpoint.participant_key, GONE)
        return Client(self._node_of.get(endpoint.key, ""), client.addresses, client.process)

    def _clients(self) -> dict[UUID, Client]:
        """Return the participants as clients without nodes; note the nodes of their endpoints."""
        for told in self._nodes.take(N=MOST):
            if not isinstance(told, InvalidSample):
                for node in told.node_entities_info_seq:
                    name = f"{node.node_namespace.rstrip('/')}/{node.node_name}"
                    for gid in (*node.writer_gid_seq, *node.reader_gid_seq):
                        self._node_of[UUID(bytes=bytes(gid.data))] = name
        return {one.key: _client(one) for one, _ in self._participants.so_far().values()}


class _Told:
    """The participants, publishers or subscribers that a built-in topic has told of so far.

    Each change is read once. To read 300 publishers again takes 70 ms (measured), in which a served arm would stand.
    """

    def __init__(self, reader: BuiltinDataReader):
        self._reader, self._lock = reader, Lock()
        self._known: dict[Hashable, tuple[Any, bool]] = {}

    def so_far(self) -> dict[Hashable, tuple[Any, bool]]:
        """Return what was told of each, by its handle, and whether it is still there."""
        with self._lock:
            for one in self._reader.take(N=MOST):
                handle, alive = one.sample_info.instance_handle, one.sample_info.instance_state == InstanceState.Alive
                if one.sample_info.valid_data:
                    self._known[handle] = one, alive
                elif handle in self._known:  # it has ended: this tells no more than its handle
                    self._known[handle] = self._known[handle][0], alive
            return dict(self._known)


def _client(participant: Any) -> Client:
    """Return a participant's addresses and process, as Cyclone or Fast DDS tells them."""
    told = {one.key: one.value for one in participant.qos if isinstance(one, Policy.Property)}
    addresses = [one.partition("/")[2].rpartition(":")[0] for one in told.get("__NetworkAddresses", "").split(",")]
    process = told.get("__Pid") or told.get("fastdds.physical_data.process", "")
    return Client(addresses=tuple(dict.fromkeys(one.strip("[]") or HERE for one in addresses)), process=process)


def _ros_name(kind: str) -> str:
    """Return ``sensor_msgs/JointState`` for ``sensor_msgs::msg::dds_::JointState_``."""
    package, _, rest = kind.partition("::")
    return f"{package}/{rest.rpartition('::')[2].removesuffix('_')}"
