"""A flight in ROS 2 while it is flown: what the service's live port tells, as the messages that a recording's bag has."""

from collections import Counter
from collections.abc import Callable
from typing import Any

from companion.recording import channels
from companion.recording import records as rec
from companion.recording.reading import FOR_VIEWERS, NOT_UNDERSTOOD, EventAssembly, instant
from companion.tools.ros2.live_client import LiveClient
from companion.tools.ros2.messages import RosMessages
from companion.tools.ros2.node import RosNode
from companion.tools.ros2.typestore import typestore
from estimator.vision.camera import Camera

_NO_MESSAGES = (rec.FusionRecord, rec.LinkRecord, rec.OrderRecord)
"""Records for which ROS has no standard message."""


def wanted(topic: str) -> bool:
    """Return whether a topic of the live port leads to messages of ROS."""
    return topic in channels.TOPICS and topic not in FOR_VIEWERS and not issubclass(channels.TOPICS[topic], _NO_MESSAGES)


class RosBridge:
    """Publishes what a client receives.

    Args:
        camera: the vehicle's camera; None leaves out its place on the vehicle and `/camera/camera_info`.
        note: is told what a person should know.
        gimballed: whether a gimbal turns the camera.
    """

    def __init__(
        self, client: LiveClient, node: RosNode, camera: Camera | None, note: Callable[[str], None], *, gimballed: bool = False
    ) -> None:
        self._client = client
        self._node = node
        self._camera, self._gimballed = camera, gimballed
        self._note = note
        self._store: Any = typestore()
        self.published: Counter[str] = Counter()
        """Messages by topic."""
        self.skipped: Counter[str] = Counter()
        """Messages of the live port that this version does not understand, by topic."""

    async def run(self) -> None:
        """Publish until cancelled.

        Raises:
            BadInput: the address or the token is wrong.
        """
        connection, messages, assembled = 0, None, EventAssembly()
        async for topic, at_ns, data in self._client.messages():
            if self._client.connections != connection:
                connection, messages, assembled = self._client.connections, None, EventAssembly()
            try:
                event = assembled.event(topic, data)
                if event is None:
                    continue
                if messages is None:
                    # The viewers' time axis is Unix time, and the events have the service's own clock.
                    messages = RosMessages(self._store.types, at_ns - instant(event), self._camera, gimballed=self._gimballed)
                    self._publish(messages.fixed(instant(event)))
                for message in messages.of(event):
                    self._publish(message)
            except NOT_UNDERSTOOD:
                self.skipped[topic] += 1
                if self.skipped[topic] == 1:
                    self._note(f"{topic}: a message is not understood: is the service of another version? More are counted")

    def _publish(self, message: tuple[str, str, int, Any]) -> None:
        topic, kind, _, value = message
        known = len(self._node.unknown)
        self._node.publish(topic, kind, bytes(self._store.serialize_cdr(value, kind)))
        if len(self._node.unknown) > known:
            self._note(f"{topic}: this ROS has no {kind}; the topic is left out")
        if topic not in self._node.unknown:
            self.published[topic] += 1
