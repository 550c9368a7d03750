"""The node in ROS 2: messages go out as the bytes that they are (CDR), so only their types are asked of the ROS that is there."""

import importlib
from collections.abc import Mapping
from typing import Any

from estimator.contracts.errors import BadInput

KEPT = ("/tf_static",)
"""Topics whose newest message a late subscriber gets, too (transient local)."""
_DEPTH = 10


class RosNode:
    """A node with a publisher for each topic, made with its first message.

    Raises:
        BadInput: there is no ROS 2 for this Python.
    """

    def __init__(self, name: str) -> None:
        try:
            self._rclpy: Any = importlib.import_module("rclpy")
            self._qos: Any = importlib.import_module("rclpy.qos")
            self._utilities: Any = importlib.import_module("rosidl_runtime_py.utilities")
            signals: Any = importlib.import_module("rclpy.signals")
        except ImportError as why:
            raise BadInput(
                f"there is no ROS 2 for this Python: {why}; source /opt/ros/DISTRO/setup.bash, install decklander for its Python"
            ) from why
        # Our own handlers end the bridge; rclpy's would take their place.
        self._rclpy.init(args=[], signal_handler_options=signals.SignalHandlerOptions.NO)
        self._node: Any = self._rclpy.create_node(name)
        self._publishers: dict[str, Any] = {}
        self._unknown: dict[str, str] = {}

    @property
    def unknown(self) -> Mapping[str, str]:
        """Topics that are not published, because this ROS has no such message; and its name."""
        return self._unknown

    def publish(self, topic: str, kind: str, message: bytes) -> None:
        """Publish a message, given as CDR with its header; it is left out if this ROS does not know its type."""
        if topic in self._unknown:
            return
        if topic not in self._publishers:
            try:
                known = self._utilities.get_message(kind)
            except (ImportError, AttributeError, LookupError, ValueError):
                self._unknown[topic] = kind
                return
            self._publishers[topic] = self._node.create_publisher(known, topic, self._quality(topic))
        self._publishers[topic].publish(message)

    def close(self) -> None:
        """End the node."""
        self._node.destroy_node()
        self._rclpy.try_shutdown()

    def _quality(self, topic: str) -> Any:
        if topic not in KEPT:
            return self._qos.QoSProfile(depth=_DEPTH)
        return self._qos.QoSProfile(depth=1, durability=self._qos.DurabilityPolicy.TRANSIENT_LOCAL)
