"""Stands in for ROS 2's Python library where there is no ROS: it writes down what is published, one JSON object a line."""

from __future__ import annotations

import json
import os
from typing import Any

from .qos import QoSProfile
from .signals import SignalHandlerOptions

_opened: list[Any] = []


def init(*, args: list[str], signal_handler_options: SignalHandlerOptions) -> None:
    """Begin to write into the file that $STAND_IN_ROS names."""
    assert args == []
    assert signal_handler_options is SignalHandlerOptions.NO
    _opened.append(open(os.environ["STAND_IN_ROS"], "w"))  # noqa: SIM115 - closed by try_shutdown


def try_shutdown() -> None:
    """End."""
    _opened.pop().close()


def create_node(name: str) -> Node:
    """Return a node."""
    return Node(name)


class Publisher:
    """Writes down each message as it is given: as bytes."""

    def __init__(self, kind: str, topic: str, qos: QoSProfile) -> None:
        self._fields = {"topic": topic, "kind": kind, "durability": qos.durability.name}

    def publish(self, message: bytes) -> None:
        """Write a message down."""
        _opened[-1].write(json.dumps({**self._fields, "cdr": message.hex()}) + "\n")
        _opened[-1].flush()


class Node:
    """A node that only publishes."""

    def __init__(self, name: str) -> None:
        assert name

    def create_publisher(self, kind: str, topic: str, qos: QoSProfile) -> Publisher:
        """Return a publisher."""
        return Publisher(kind, topic, qos)

    def destroy_node(self) -> None:
        """End the node."""
