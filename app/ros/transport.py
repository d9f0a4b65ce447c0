"""How messages reach ROS 2: by rclpy where it is importable, else by DDS itself.

Both carry CDR bytes, which `app/ros/messages.py` makes and reads, so they differ in nothing else.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import os
import socket
from collections import deque
from collections.abc import Iterator
from typing import Any, Protocol
from xml.sax.saxutils import quoteattr

from app.output import InputError, say
from app.ros.messages import Told, encoded, field_types, type_hash

_DEPTH = 10
_MOST_TAKEN = 100
# Participants on this machine that are looked for one by one: loopback has no multicast.
_MOST_PARTICIPANTS = 32


class Transport(Protocol):
    """Topics by their ROS names without the slash, kinds such as `nav_msgs/msg/Path`."""

    def publish(self, told: Told) -> None:
        """Sends a message; whoever comes late gets the last one where that is asked for."""
        ...

    def subscribe(self, topic: str, kind: str, *, is_latched: bool = False) -> None:
        """Lets `received` give what comes on the topic."""
        ...

    def received(self) -> Iterator[tuple[str, str, bytes]]:
        """Topic, kind and CDR bytes of what has come since; never waits."""
        ...

    def close(self) -> None:
        """Leaves."""
        ...


def open_transport(*, domain: int, network: bool, interface: str | None) -> Transport:
    """The transport that there is, in a DDS domain; on this machine alone without `network`.

    Raises:
        InputError: There is none, or it cannot use this domain or interface.
    """
    if importlib.util.find_spec("rosbags") is None:
        raise InputError("ros2 needs the package rosbags: python -m pip install -e '.[ros2]'")
    if importlib.util.find_spec("rclpy") is not None:
        return _Rclpy(domain, network=network, interface=interface)
    if importlib.util.find_spec("cyclonedds") is None:
        raise InputError(
            "ros2 needs rclpy or the package cyclonedds: python -m pip install -e '.[ros2]'"
        )
    return _CycloneDds(domain, network=network, interface=interface)


def _configuration(*, network: bool, interface: str | None) -> str:
    """Of Cyclone DDS: which interfaces it binds to, and how participants find each other."""
    if network:
        which = "autodetermine='true'" if interface is None else f"name={quoteattr(interface)}"
        return (
            "<CycloneDDS><Domain Id='any'><General><Interfaces>"
            f"<NetworkInterface {which}/></Interfaces></General></Domain></CycloneDDS>"
        )
    return (
        "<CycloneDDS><Domain Id='any'><General>"
        "<Interfaces><NetworkInterface address='127.0.0.1'/></Interfaces>"
        "<AllowMulticast>false</AllowMulticast></General><Discovery>"
        "<ParticipantIndex>auto</ParticipantIndex>"
        f"<MaxAutoParticipantIndex>{_MOST_PARTICIPANTS}</MaxAutoParticipantIndex>"
        "<Peers><Peer address='127.0.0.1'/></Peers></Discovery></Domain></CycloneDDS>"
    )


def _udp_sockets() -> set[int]:
    """Descriptors of this process's UDP sockets; none where the system does not list them."""
    found = set()
    for name in os.listdir("/proc/self/fd") if os.path.isdir("/proc/self/fd") else ():
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(int(name))) as one:
            if one.family == socket.AF_INET and one.type == socket.SOCK_DGRAM:
                found.add(int(name))
    return found


def _keep_on_loopback(sockets: set[int]) -> None:
    """Lets these sockets hear nothing from outside.

    Cyclone DDS binds those that receive to every address, whatever interface it is told to use.
    """
    bind = getattr(socket, "SO_BINDTODEVICE", None)
    if bind is None or not sockets:
        say("warning: this system lets other machines send to the node; a firewall can prevent it")
        return
    for descriptor in sockets:
        with socket.socket(fileno=os.dup(descriptor)) as one:
            one.setsockopt(socket.SOL_SOCKET, bind, b"lo")


class _CycloneDds:
    """A DDS participant that names topics and types as ROS 2 does."""

    def __init__(self, domain: int, *, network: bool, interface: str | None) -> None:
        from cyclonedds.core import DDSException
        from cyclonedds.domain import Domain, DomainParticipant

        configuration = _configuration(network=network, interface=interface)
        before = _udp_sockets()
        try:
            self._domain = Domain(domain, configuration)
            self._participant = DomainParticipant(domain)
        except DDSException as error:
            where = "" if interface is None else f" on the interface {interface!r}"
            raise InputError(f"--domain {domain}: cannot be joined{where}: {error.msg}") from None
        if not network:
            _keep_on_loopback(_udp_sockets() - before)
        self._types: dict[str, Any] = {}
        self._writers: dict[str, Any] = {}
        self._readers: dict[str, tuple[str, Any]] = {}

    def publish(self, told: Told) -> None:
        from cyclonedds.pub import DataWriter

        if told.topic not in self._writers:
            qos = self._qos(told.kind, told.is_latched)
            topic = self._topic(told.topic, told.kind)
            self._writers[told.topic] = DataWriter(self._participant, topic, qos)
        self._writers[told.topic].write(self._type(told.kind)(encoded(told.kind, told.message)))

    def subscribe(self, topic: str, kind: str, *, is_latched: bool = False) -> None:
        from cyclonedds.qos import Policy, Qos
        from cyclonedds.sub import DataReader

        qos = self._qos(kind, is_latched)
        # Who generates code from a message names its fields in one of two ways: `data`, `data_`.
        coercion = Policy.TypeConsistency.AllowTypeCoercion(ignore_member_names=True)
        reader = DataReader(self._participant, self._topic(topic, kind), qos + Qos(coercion))
        self._readers[topic] = kind, reader

    def received(self) -> Iterator[tuple[str, str, bytes]]:
        for topic, (kind, reader) in self._readers.items():
            for sample in reader.take(_MOST_TAKEN):
                if hasattr(sample, "cdr"):
                    yield topic, kind, sample.cdr

    def close(self) -> None:
        self._writers.clear()
        self._readers.clear()
        del self._participant, self._domain

    def _topic(self, name: str, kind: str) -> Any:
        from cyclonedds.topic import Topic

        return Topic(self._participant, f"rt/{name}", self._type(kind))

    def _type(self, kind: str) -> Any:
        if kind not in self._types:
            self._types[kind] = _bytes_type(kind)
        return self._types[kind]

    @staticmethod
    def _qos(kind: str, is_latched: bool) -> Any:
        from cyclonedds.qos import Policy, Qos
        from cyclonedds.util import duration

        durability = Policy.Durability
        return Qos(
            Policy.Reliability.Reliable(duration(milliseconds=100)),
            Policy.History.KeepLast(1 if is_latched else _DEPTH),
            durability.TransientLocal if is_latched else durability.Volatile,
            Policy.DataRepresentation(use_cdrv0_representation=True),
            # By this ROS 2 from Iron on knows the definition.
            Policy.Userdata(f"typehash={type_hash(kind)};".encode()),
        )


def _bytes_type(kind: str) -> Any:
    """A type for Cyclone DDS of the message's name and fields whose samples are CDR bytes."""
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.idl import types as idl_types

    types: Any = idl_types
    plain: dict[str, Any] = {"string": str, "bool": bool, "octet": types.uint8}

    def of_field(field: tuple[str, Any, int]) -> Any:
        shape, inner, count = field
        if shape == "base":
            return plain.get(inner) or getattr(types, inner)
        if shape == "name":
            return struct(inner)
        part = of_field(inner)
        return types.array[part, count] if shape == "array" else types.sequence[part]

    known: dict[str, Any] = {}

    def struct(name: str) -> Any:
        if name not in known:
            package, _, short = name.split("/")
            fields = {key: of_field(field) for key, field in field_types(name)}
            full = f"{package}.msg.dds_.{short}_"
            known[name] = make_idl_struct(full.replace(".", "_"), full, fields)
        return known[name]

    base = struct(kind)

    def take(sample: Any, cdr: bytes | None = None, **_: Any) -> None:
        # Without bytes it says that a writer has left.
        if cdr is not None:
            sample.cdr = cdr

    # Cyclone DDS asks the class for bytes and gives it bytes: they pass as they are.
    base.__init__ = take
    base.serialize = lambda sample, **_: sample.cdr
    base.deserialize = classmethod(lambda cls, cdr, **_: cls(bytes(cdr)))
    return base


class _Rclpy:
    """A node of ROS 2's own library."""

    def __init__(self, domain: int, *, network: bool, interface: str | None) -> None:
        if interface is not None:
            raise InputError("--interface: with rclpy the interface is set where its DDS is set up")
        # Read when the node is made: the first by ROS 2 up to Humble, the second from Iron on.
        os.environ["ROS_LOCALHOST_ONLY"] = "0" if network else "1"
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET" if network else "LOCALHOST"
        import rclpy

        self._rclpy = rclpy
        self._context = rclpy.context.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node("footstep_planner", context=self._context)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._publishers: dict[str, Any] = {}
        self._inbox: deque[tuple[str, str, bytes]] = deque()

    def publish(self, told: Told) -> None:
        if told.topic not in self._publishers:
            self._publishers[told.topic] = self._node.create_publisher(
                _message_class(told.kind), told.topic, self._qos(told.is_latched)
            )
        self._publishers[told.topic].publish(encoded(told.kind, told.message))

    def subscribe(self, topic: str, kind: str, *, is_latched: bool = False) -> None:
        self._node.create_subscription(
            _message_class(kind),
            topic,
            lambda cdr: self._inbox.append((topic, kind, bytes(cdr))),
            self._qos(is_latched),
            raw=True,
        )

    def received(self) -> Iterator[tuple[str, str, bytes]]:
        for _ in range(_MOST_TAKEN):
            before = len(self._inbox)
            self._executor.spin_once(timeout_sec=0.0)
            if len(self._inbox) == before:
                break
        while self._inbox:
            yield self._inbox.popleft()

    def close(self) -> None:
        self._node.destroy_node()
        self._rclpy.shutdown(context=self._context)

    @staticmethod
    def _qos(is_latched: bool) -> Any:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        durability = DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE
        return QoSProfile(
            depth=1 if is_latched else _DEPTH,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=durability,
        )


def _message_class(kind: str) -> Any:
    package, _, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)
