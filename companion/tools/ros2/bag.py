"""Write a recording as a ROS 2 bag by the library rosbags, which is installed with the extra `ros2`."""

import shutil
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from companion.recording.reading import Recording, instant
from companion.tools.ros2.messages import Message, RosMessages, require_rosbags, typestore
from companion.tools.ros2.node import KEPT
from estimator.contracts.errors import BadInput

_METADATA_VERSION: Final = 8
"""Version that ROS 2 Humble and everything later reads; the newer 9 is that of Jazzy."""


def export(recording: Recording, folder: Path) -> dict[str, int]:
    """Write the recording as a bag with the storage plug-in sqlite3, and return the number of messages of each topic.

    Args:
        folder: the bag; it is made, and removed again if it cannot be finished.

    Raises:
        BadInput: rosbags is not installed; the folder exists or cannot be written; the recording's camera is not understood.
    """
    require_rosbags("--format ros2")
    if folder.exists() or folder.is_symlink():
        raise BadInput(f"{folder}: exists already, and a bag is written into a folder of its own: name another --output")
    offset_ns, camera = recording.offset_ns(), recording.camera()
    try:
        bag = _Bag(folder)
    except OSError as why:
        raise BadInput(f"{folder}: cannot write a bag there: {why.strerror or why}") from why
    try:
        messages = RosMessages(bag.types, offset_ns, camera, gimballed=_gimballed(recording))
        for event in recording.events():
            if not bag.counts:
                bag.add(messages.fixed(instant(event)))
            for message in messages.of(event):
                bag.add(message)
        bag.close()
    except BaseException as why:
        bag.abandon()
        if _is_fault_of_disk(why):
            raise BadInput(f"{folder}: cannot write a bag there: {why}") from why
        raise
    return dict(bag.counts)


class _Bag:
    """A bag that is being written: each topic is declared with its first message."""

    def __init__(self, folder: Path) -> None:
        from rosbags.rosbag2 import Writer

        self._folder = folder
        self._store: Any = typestore()
        self.types = self._store.types
        self._connections: dict[str, Any] = {}
        self.counts: Counter[str] = Counter()
        self._writer: Any = Writer(folder, version=_METADATA_VERSION)
        self._writer.open()

    def add(self, message: Message) -> None:
        topic, kind, at_ns, value = message
        if topic not in self._connections:
            qos = [_kept()] if topic in KEPT else []
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store, offered_qos_profiles=qos)
        self._writer.write(self._connections[topic], at_ns, self._store.serialize_cdr(value, kind))
        self.counts[topic] += 1

    def close(self) -> None:
        self._writer.close()

    def abandon(self) -> None:
        """Remove what was written."""
        with suppress(Exception):  # of the storage, which may be what failed
            self._writer.abort()
        shutil.rmtree(self._folder, ignore_errors=True)


def _gimballed(recording: Recording) -> bool:
    """Return whether a gimbal turned the camera; settings of another version are not understood, and had none."""
    try:
        settings = recording.settings()
    except BadInput:
        return False
    return settings is not None and settings.camera.gimbal.given


def _is_fault_of_disk(why: BaseException) -> bool:
    """Return whether the disk refused, or apsw, the library below rosbags, says so of the database."""
    return isinstance(why, OSError) or type(why).__module__ == "apsw"


def _kept() -> Any:
    """Return the quality of service of a topic whose newest message late subscribers get, too."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(2147483647, 4294967295)
    return Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, forever, forever,
        QosLiveliness.AUTOMATIC, forever, False,
    )  # fmt: skip
