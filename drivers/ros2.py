"""A node of ROS 2: by the middleware of an installed ROS (rclpy), or by DDS without ROS (Eclipse Cyclone DDS).

Messages are the bytes that they are on the wire, CDR with its header. Names in DDS: design.ros2.org, "Topic and Service name
mapping to DDS". The header of a service's request and reply there is that of rmw_cyclonedds_cpp, the client and its number; other
middlewares put theirs beside the payload, where this library cannot read it.
"""

import os
import struct
from collections import Counter
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

from drivers.extras import require
from estimator.contracts.errors import BadInput, Recoverable, refused

MIDDLEWARES = ("auto", "rclpy", "dds")
_DEPTH = 10
"""Messages of a topic that wait for a reader; a newer one takes the oldest one's place."""
_TRIGGER = "std_srvs/srv/Trigger"
_BY_NAMES = "<Compatibility><IgnoreTypeInformation>1.15,1.16</IgnoreTypeInformation></Compatibility>"
"""Compare types by their names, as ROS does: what Fast DDS says of bytes is not what this library has for them."""
_CDR_HEAD = b"\x00\x01\x00\x00"
"""The header of CDR in little-endian order."""
_CLIENT = 16  # bytes of a client and its request's number behind that header


class Request(NamedTuple):
    """A request of the service std_srvs/Trigger, or a message on a topic, which has no answer."""

    sent_at_ns: int
    """Unix time of its sender's clock."""
    answer: Callable[[bool, str], None]


_Take = Callable[[], list[tuple[bytes, int]]]
"""Takes messages, each with its sender's Unix time in ns."""


def typestore() -> Any:
    """Return the standard messages.

    Those that later grew have the fields of Jazzy. An older ROS reads them: it leaves out what comes after the end.
    """
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def open_node(name: str, middleware: str = "auto") -> "RosNode":
    """Open a node in the domain ROS_DOMAIN_ID: that of the installed ROS where there is one, else by DDS.

    Args:
        middleware: one of MIDDLEWARES.

    Raises:
        BadInput: what it needs is not installed, or ROS_DOMAIN_ID is no number from 0 to 232.
        Recoverable: the middleware cannot open its sockets.
    """
    require("ROS 2", "ros2", "rosbags")
    domain = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not (domain.isascii() and domain.isdigit() and int(domain) <= 232):
        raise BadInput(f"ROS_DOMAIN_ID must be a number from 0 to 232, found {domain!r}")
    why: ImportError | None = None
    for known, kind in (("rclpy", _RclpyNode), ("dds", _DdsNode)):
        if middleware in ("auto", known):
            try:
                return kind(name, int(domain))
            except ImportError as missing:
                why = why or missing
    raise BadInput(
        f"there is no ROS 2 for this Python: {why}; source /opt/ros/DISTRO/setup.bash, or install the extra decklander[ros2]"
    )


class _RclpyNode:
    """See `_DdsNode`: the same, by the installed ROS. Its `lost` counts nothing."""

    def __init__(self, name: str, domain: int) -> None:
        self._rclpy: Any = import_module("rclpy")
        self._qos: Any = import_module("rclpy.qos")
        self._types: Any = import_module("rosidl_runtime_py.utilities")
        signals: Any = import_module("rclpy.signals")
        self.lost = Counter[str]()
        with refused("rclpy", RuntimeError, by=Recoverable):
            # Our own handlers end the program; rclpy's would take their place.
            self._rclpy.init(args=[], signal_handler_options=signals.SignalHandlerOptions.NO)
            self._node: Any = self._rclpy.create_node(name)

    def writer(self, topic: str, kind: str, kept: bool = False) -> Callable[[bytes], None] | None:
        try:
            known = self._types.get_message(kind)
        except (ImportError, AttributeError, LookupError, ValueError):
            return None
        durability = self._qos.DurabilityPolicy.TRANSIENT_LOCAL if kept else self._qos.DurabilityPolicy.VOLATILE
        publisher = self._node.create_publisher(
            known, topic, self._qos.QoSProfile(depth=1 if kept else _DEPTH, durability=durability)
        )
        return publisher.publish  # type: ignore[no-any-return]

    def reader(self, topic: str, kind: str, *, reliable: bool) -> _Take:
        qos = self._qos.QoSProfile(depth=_DEPTH) if reliable else self._qos.qos_profile_sensor_data
        # Nothing spins the node: what came is taken when it is called for, and no callback is ever called.
        reader = self._node.create_subscription(self._types.get_message(kind), topic, print, qos, raw=True)

        def take() -> list[tuple[bytes, int]]:
            taken = [one for _ in range(_DEPTH) if (one := reader.handle.take_message(reader.msg_type, True))]
            return [(bytes(message), about["source_timestamp"]) for message, about in taken]

        return take

    def server(self, name: str) -> Callable[[], list[Request]]:
        service = self._node.create_service(self._types.get_service(_TRIGGER), name, print)

        def take() -> list[Request]:
            _, header = service.handle.service_take_request(service.srv_type.Request)

            def answer(accepted: bool, text: str) -> None:
                service.send_response(service.srv_type.Response(success=accepted, message=text), header)

            return [] if header is None else [Request(header.source_timestamp, answer)]

        return take

    def close(self) -> None:
        self._node.destroy_node()
        self._rclpy.try_shutdown()


class _DdsNode:
    """Writers, readers and servers of topics and services, which take what came since the last call; for one thread."""

    def __init__(self, name: str, domain: int) -> None:
        self._core: Any = import_module("cyclonedds.core")
        self.lost = Counter[str]()
        """Messages that are `blocked`, as a reader does not take them, and requests that are `unreadable`."""
        self._types: dict[str, Any] = {}
        os.environ["CYCLONEDDS_URI"] = f"{_BY_NAMES},{os.environ.get('CYCLONEDDS_URI', '')}".rstrip(",")
        with refused("DDS", self._core.DDSException, by=Recoverable):
            self._participant: Any = import_module("cyclonedds.domain").DomainParticipant(domain)

    def writer(self, topic: str, kind: str, kept: bool = False, prefix: str = "rt") -> Callable[[bytes], None]:
        writer, of = self._endpoint("pub", "DataWriter", prefix + topic, kind, True, kept)

        def write(cdr: bytes) -> None:
            try:
                writer.write(of.deserialize(cdr))
            except self._core.DDSException:
                self.lost["blocked"] += 1

        return write

    def reader(self, topic: str, kind: str, *, reliable: bool, prefix: str = "rt") -> _Take:
        reader, _ = self._endpoint("sub", "DataReader", prefix + topic, kind, reliable, False)

        def take() -> list[tuple[bytes, int]]:
            with refused("DDS", self._core.DDSException, by=Recoverable):
                return [(m.cdr, m.sample_info.source_timestamp) for m in reader.take(_DEPTH) if hasattr(m, "cdr")]

        return take

    def server(self, name: str) -> Callable[[], list[Request]]:
        # A client waits until it has found both, so the reply's writer is there from the start.
        reply = self.writer(f"{name}Reply", f"{_TRIGGER}_Response", prefix="rr")
        requests = self.reader(f"{name}Request", f"{_TRIGGER}_Request", reliable=True, prefix="rq")

        def answer_to(client: bytes) -> Callable[[bool, str], None]:
            return lambda accepted, text: reply(
                _CDR_HEAD + client + struct.pack("<?3xI", accepted, len(text.encode()) + 1) + text.encode() + b"\0"
            )

        def take() -> list[Request]:
            taken = requests()
            good = [(cdr[4 : 4 + _CLIENT], at) for cdr, at in taken if len(cdr) > 4 + _CLIENT and cdr[:2] == _CDR_HEAD[:2]]
            self.lost["unreadable"] += len(taken) - len(good)
            return [Request(sent_at_ns, answer_to(client)) for client, sent_at_ns in good]

        return take

    def close(self) -> None:
        self._participant = None

    def _endpoint(self, module: str, end: str, name: str, kind: str, reliable: bool, kept: bool) -> tuple[Any, Any]:
        policy, of = self._core.Policy, self._types.setdefault(kind, _bytes_of(kind))
        qos = self._core.Qos(
            # A reader that stands still costs it messages, and us no time.
            policy.Reliability.Reliable(max_blocking_time=0) if reliable else policy.Reliability.BestEffort,
            policy.Durability.TransientLocal if kept else policy.Durability.Volatile,
            policy.History.KeepLast(1 if kept else _DEPTH),
            policy.DataRepresentation(use_cdrv0_representation=True),
        )
        with refused("DDS", self._core.DDSException, by=Recoverable):
            topic = import_module("cyclonedds.topic").Topic(self._participant, name, of)
            return getattr(import_module(f"cyclonedds.{module}"), end)(self._participant, topic, qos), of


RosNode = _RclpyNode | _DdsNode


def _bytes_of(kind: str) -> Any:
    """Return a type of DDS that is but a name: its messages stay bytes."""
    package, form, name = kind.split("/")
    idl: Any = import_module("cyclonedds.idl")
    of = idl.make_idl_struct(f"{name}_", f"{package}.{form}.dds_.{name}_", {"content": idl.types.uint8})

    def deserialize(cdr: bytes, *args: Any, **kwargs: Any) -> Any:
        out = of.__new__(of)
        out.cdr = bytes(cdr)
        return out

    of.serialize = lambda self, *args, **kwargs: self.cdr
    of.deserialize = of.deserialize_key = staticmethod(deserialize)
    return of
