"""Write a recording as a ROS 2 bag, and read bags of ROS 1 and 2, by the library rosbags (the extra `ros2`).

Read are sensor_msgs Imu, Range, Image and CompressedImage, and a velocity in `base_stabilized` as our own bags have it, all in
the axes of REP-103. An IMU's frame is joined to `base_link` by /tf_static; one that nothing joins is read where its mean force
points up, as in the body's axes. Of several IMUs the one with the most messages is read. Of several cameras the raw one is,
since a camera file describes the lens; images that other programs made come after it, and depth last. A header's stamp counts
where it is of the clock by which the bag was written; else a message counts as measured when it was written.
"""

import math
import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from itertools import islice, takewhile
from pathlib import Path
from typing import Any, Final

import numpy as np

from companion.recording.reading import Recording
from companion.tools.ros2.messages import ENU_NED, KEPT, LEVEL, UP, Message, RosMessages
from drivers.camera.images import ImageRefused
from drivers.camera.ros2 import image_px
from drivers.extras import require
from drivers.files import Largest, opened, refuse_special, seen_in
from drivers.importer import ForeignFile
from drivers.log_stamps import SIGMA_S, SIGMA_TILT_RAD, SIGMA_YAW_RAD, Tell, timeline
from drivers.ros2 import typestore
from estimator.contracts.errors import BadInput, refused
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, BodyVelocity, Frame, Imu, Range, Sample
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp

_METADATA_VERSION: Final = 8
"""Version that ROS 2 Humble and everything later reads; the newer 9 is that of Jazzy."""
_LATEST_NS: Final = 5 * NS_PER_S
"""A header whose stamp is older than this when its message is written is of another clock."""
_LOOK = 200  # messages at a topic's begin by which it is judged
_UPRIGHT = math.cos(math.radians(35.0))  # least share of their mean force that points up in the body's axes


def export(recording: Recording, folder: Path) -> dict[str, int]:
    """Write the recording as a bag with the storage plug-in sqlite3, and return the number of messages of each topic.

    Args:
        folder: the bag; it is made, and removed again if it cannot be finished.

    Raises:
        BadInput: rosbags is not installed; the folder exists or cannot be written; the recording's camera is not understood.
    """
    require("--format ros2", "ros2", "rosbags")
    if folder.exists() or folder.is_symlink():
        raise BadInput(f"{folder}: exists already, and a bag is written into a folder of its own: name another --output")
    offset_ns, camera = recording.offset_ns(), recording.camera()
    with refused(f"{folder}: cannot write a bag there", OSError):
        bag = _Bag(folder)
    try:
        settings = None
        with suppress(BadInput):  # settings of another version are not understood, and had no gimbal
            settings = recording.settings()
        gimballed = settings is not None and settings.camera.gimbal.given
        messages = RosMessages(bag.store, offset_ns, camera, gimballed=gimballed)
        for event in recording.events():
            for message in messages.of(event):
                bag.add(message)
        bag.close()
    except BaseException as why:
        bag.abandon()
        # The disk refused, or apsw, the library below rosbags, says so of the database.
        if isinstance(why, OSError) or type(why).__module__ == "apsw":
            raise BadInput(f"{folder}: cannot write a bag there: {why}") from why
        raise
    return dict(bag.counts)


class _Bag:
    """A bag that is being written: each topic is declared with its first message."""

    def __init__(self, folder: Path) -> None:
        from rosbags.rosbag2 import Writer

        self._folder = folder
        self.store: Any = typestore()
        self._connections: dict[str, Any] = {}
        self.counts: Counter[str] = Counter()
        self._writer: Any = Writer(folder, version=_METADATA_VERSION)
        self._writer.open()

    def add(self, message: Message) -> None:
        topic, kind, at_ns, value = message
        if topic not in self._connections:
            qos = [_kept()] if topic in KEPT else []
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self.store, offered_qos_profiles=qos)
        self._writer.write(self._connections[topic], at_ns, self.store.serialize_cdr(value, kind))
        self.counts[topic] += 1

    def close(self) -> None:
        self._writer.close()

    def abandon(self) -> None:
        """Remove what was written."""
        with suppress(Exception):  # of the storage, which may be what failed
            self._writer.abort()
        shutil.rmtree(self._folder, ignore_errors=True)


def _kept() -> Any:
    """Return the quality of service of a topic whose newest message late subscribers get, too."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(2147483647, 4294967295)
    return Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, forever, forever,
        QosLiveliness.AUTOMATIC, forever, False,
    )  # fmt: skip


_DOWN = ("down", "rangefinder", "altimeter")
"""Names in the topic or frame of a range sensor that looks down; the message itself has no direction."""
_ANY = Stamp(MonoNs(0), MonoNs(0), SIGMA_S, "synced")
_BODIES = ("", "base_link", "base_footprint")
"""Frames of the body's own axes, and that of a message that names none."""
_BAGS = (".db3", ".mcap", ".bag")
_MADE = re.compile(
    r"rect|undistort|scaled|resize|detect|debug|overlay|annotat|result|track|draw|marker|mask|segment|label|output|stitch"
)
"""Parts of names of topics whose images another program made."""
_DEPTH = re.compile(r"(?i)16UC1|32FC1|mono16|TYPE_|disparity|depth")
"""Encodings and names of what is no picture."""


def import_bag(file: ForeignFile) -> Iterator[Sample | Frame]:
    """Read a bag as an importer (`drivers.importer.Read`)."""
    return read(file.path, file.tell, file.topic)


def read(path: Path, tell: Tell, topic: str = "") -> Iterator[Sample | Frame]:
    """Yield what a bag holds in the order in which it was written, the first measurement at 0.

    Args:
        path: a bag's folder (ROS 2), with its metadata or without, or its file (`.bag`, `.db3`, `.mcap`), whatever its name.
        topic: of the camera that is read; empty for the best of those there are.

    Raises:
        BadInput: rosbags is not installed; the bag cannot be read, or nothing in it is imported.
    """
    require("record import of a bag", "ros2", "rosbags")
    from rosbags.highlevel import AnyReader

    with tempfile.TemporaryDirectory(prefix="decklander-") as folder:
        bare = path.is_dir() and not (path / "metadata.yaml").is_file()
        names = list[Path]()
        for n, each in enumerate(sorted(f for f in path.iterdir() if f.suffix in _BAGS and f.name[0] != ".") if bare else [path]):
            for inner in seen_in(each) if each.is_dir() else [each]:
                refuse_special(inner, Largest.RECORDING)
            names.append(Path(folder) / f"bag{n}{_suffix(each)}")
            names[-1].symlink_to(each.resolve())
        if bare:
            tell(f"the folder has no metadata.yaml: its files are read together, in order of their times ({len(names)})")
        try:
            with AnyReader(names, default_typestore=typestore()) as bag:
                yield from _Import(bag, path, tell, topic).messages()
        except BadInput:
            raise
        except Exception as why:  # of the library and of what it calls: any of a damaged bag
            raise BadInput(f"{path}: not a bag that can be read: {' '.join(str(why).split()) or type(why).__name__}") from why


def _suffix(path: Path) -> str:
    """Return the ending by which rosbags distinguishes files."""
    if path.is_dir():
        return ""
    with opened(path, Largest.RECORDING) as file:
        head = file.read(8)
    return ".bag" if head.startswith(b"#ROSBAG") else ".mcap" if head.startswith(b"\x89MCAP") else ".db3"


class _Import:
    """One pass through a bag."""

    def __init__(self, bag: Any, path: Path, tell: Tell, topic: str) -> None:
        self._bag, self._path, self._tell, self._topic = bag, path, tell, topic
        self._left_out: Counter[str] = Counter()
        self._frames = 0
        self._source_of: dict[type, str] = {}
        """The topic of the IMU's readings, and that of the attitude."""
        self._turns: dict[str, F64] = {}
        """(3, 3) matrices that turn vectors of a frame into the body's axes."""
        self._still: set[str] = set()
        """Topics of IMUs without readings: all their rates or forces are exactly 0."""

    def messages(self) -> Iterator[Sample | Frame]:
        self._turns = self._fixed_turns()
        chosen = self._chosen()
        if not chosen:
            names = ", ".join(sorted({c.msgtype for c in self._bag.connections})) or "nothing"
            raise BadInput(f"{self._path}: no IMU, range or camera in it that is imported; it holds {names}")
        when = timeline([at // 1000 for _, at, _ in self._bag.messages(connections=chosen)], self._tell)
        early = takewhile(lambda one: one[2] <= _LATEST_NS, self._read(chosen, when))
        # What was measured before the first message was written is not lost: 0 is when the earliest was measured.
        zero_ns = min((0, *(since_ns - late_ns for _, _, since_ns, late_ns in early if 0 <= late_ns <= _LATEST_NS)))
        given = 0
        for topic, message, since_ns, late_ns in self._read(chosen, when):
            if message is None:
                self._left_out[f"of {topic} are damaged"] += 1
                continue
            if not 0 <= late_ns <= _LATEST_NS:
                self._left_out[f"of {topic} have a header of another clock: their time is that of the bag"] += 1
                late_ns = 0
            stamp = Stamp(MonoNs(since_ns - zero_ns - late_ns), MonoNs(since_ns - zero_ns), SIGMA_S, "synced")
            for one in self._of(topic, message, stamp):
                given += 1
                yield one
        for why, n in sorted(self._left_out.items()):
            self._tell(f"{n} messages {why}")
        if not given:
            raise BadInput(f"{self._path}: not one message of it can be read")

    def _read(self, chosen: list[Any], when: list[int | None]) -> Iterator[tuple[str, Any, int, int]]:
        """Yield each topic, message (None if damaged), its time of writing and how long that was after its header's stamp, ns."""
        for (connection, at, data), since_ns in zip(self._bag.messages(connections=chosen), when, strict=True):
            message, late_ns = None, -1
            with suppress(Exception):  # of the library: any of a damaged message
                message = self._bag.deserialize(data, connection.msgtype)
                late_ns = at - message.header.stamp.sec * NS_PER_S - message.header.stamp.nanosec
            if since_ns is not None:
                yield connection.topic, message, since_ns, late_ns

    def _chosen(self) -> list[Any]:
        """Return the connections that are read: of each kind the best topic, and all ranges that look down.

        Raises:
            BadInput: a topic was named that is no camera's in it.
        """
        chosen = []
        by_kind: dict[str, list[Any]] = {}
        for connection in self._bag.connections:
            if connection.msgtype in _KINDS:
                by_kind.setdefault(_KINDS[connection.msgtype][0], []).append(connection)
        for kind, found in by_kind.items():
            counts: Counter[str] = Counter()
            for connection in found:
                counts[connection.topic] += connection.msgcount
            by_count = [topic for topic, _ in counts.most_common()]
            topics = set(counts if kind in ("range", "velocity") else by_count[:1])
            if kind == "camera":
                topics = {self._topic or self._choose_camera(found, by_count)}
                if not topics <= set(counts):
                    raise BadInput(f"{self._path}: --topic {self._topic} is none of its cameras: {', '.join(sorted(counts))}")
            if kind == "IMU":
                topics = self._choose_imu(found, by_count)
            chosen += [connection for connection in found if connection.topic in topics]
            how = " (--topic reads another)" if kind == "camera" else ""
            if topics and (left := sorted(set(counts) - topics)):
                self._tell(f"of the {kind}s, {', '.join(sorted(topics))} is read; left out: {', '.join(left)}{how}")
        return chosen

    def _choose_camera(self, found: list[Any], by_count: list[str]) -> str:
        """Return the topic of the camera's own images, by their encodings and names."""
        depth = {topic for topic in by_count if _DEPTH.search(topic)}
        for connection in found:
            for _, _, data in self._bag.messages(connections=[connection]):
                with suppress(Exception):  # of the library: a damaged message; the pass itself reports it
                    message = self._bag.deserialize(data, connection.msgtype)
                    coding = f"{getattr(message, 'encoding', '')} {getattr(message, 'format', '')}"
                    depth |= {connection.topic} if _DEPTH.search(coding) else set()
                break
        last = {topic: topic.removesuffix("/compressed").rpartition("/")[2].lower() for topic in by_count}
        return min(by_count, key=lambda topic: (topic in depth, bool(_MADE.search(topic.lower())), "raw" not in last[topic]))

    def _fixed_turns(self) -> dict[str, F64]:
        """Return the turns of all frames that /tf_static joins to the body, whichever of two is the parent."""
        joined: dict[str, tuple[str, F64]] = {}
        for connection in self._bag.connections:
            if connection.topic.endswith("/tf_static"):
                for _, _, data in self._bag.messages(connections=[connection]):
                    given: list[Any] = []
                    with suppress(Exception):  # of the library: a damaged message
                        given = self._bag.deserialize(data, connection.msgtype).transforms
                    for one in given:
                        q = one.transform.rotation
                        with suppress(ValueError):  # no rotation
                            turn = Rotation.from_quat([q.w, q.x, q.y, q.z]).matrix
                            joined[_frame(one.child_frame_id)] = _frame(one.header.frame_id), turn
        frames = {*joined, *(parent for parent, _ in joined.values())}
        turns = {frame: UP for frame in frames if _is_body(frame)}
        for _ in joined:  # a chain is no longer than there are transforms
            for child, (parent, turn) in joined.items():
                if parent in turns and child not in turns:
                    turns[child] = turns[parent] @ turn
                elif child in turns and parent not in turns:
                    turns[parent] = turns[child] @ turn.T
        return turns

    def _choose_imu(self, found: list[Any], by_count: list[str]) -> set[str]:
        """Return the topic of the readings and that of the attitude: our own bags have them side by side, and mavros does."""
        has: dict[str, set[type]] = {}
        for connection in found:
            first = list[Any]()
            for _, _, data in islice(self._bag.messages(connections=[connection]), _LOOK):
                with suppress(Exception):  # of the library: a damaged message; the pass itself reports it
                    first.append(self._bag.deserialize(data, connection.msgtype))
            if first and self._is_of_the_body(connection.topic, first):
                has[connection.topic] = {type(one) for one in self.imu(connection.topic, first[0], _ANY)}
        if not any(has.values()):
            return set()
        readings = next((topic for topic in by_count if Imu in has.get(topic, ())), next(t for t in by_count if has.get(t)))
        beside = sorted(by_count, key=lambda topic: (topic != readings, topic.rpartition("/")[0] != readings.rpartition("/")[0]))
        attitude = next((topic for topic in beside if Attitude in has.get(topic, ())), readings)
        self._source_of = {Imu: readings, Attitude: attitude}
        return {readings, attitude}

    def _is_of_the_body(self, topic: str, first: list[Any]) -> bool:
        """Return whether an IMU can be read, by the messages at its begin, and tell why where that is not plain."""
        forces = np.array([_vector(m.linear_acceleration) for m in first if m.linear_acceleration_covariance[0] != -1.0])
        rates = np.array([_vector(m.angular_velocity) for m in first if m.angular_velocity_covariance[0] != -1.0])
        frame, says = _frame(first[0].header.frame_id), f"{topic} is in the frame {first[0].header.frame_id!r}"
        for name, values in (("rates", rates), ("forces", forces)):
            if len(values) and not values.any():
                self._tell(f"of {topic} no readings are taken: all its {name} are exactly 0, it does not measure them")
                self._still.add(topic)
        if frame in self._turns or _is_body(frame):
            self._turns.setdefault(frame, UP)
            return True
        mean = forces.mean(axis=0) if len(forces) else np.zeros(3)
        if mean[2] >= _UPRIGHT * np.linalg.norm(mean) > 0.0:
            self._tell(
                f"{says}, which no /tf_static joins to base_link: it is read as forward, left and up, since its force points up"
            )
            self._turns[frame] = UP
            return True
        self._tell(
            f"{says}, which no /tf_static joins to base_link, and its mean force points to {np.round(mean, 1).tolist()} m/s^2 "
            "and not up: it is left out"
        )
        return False

    def _of(self, topic: str, message: Any, stamp: Stamp) -> Iterator[Sample | Frame]:
        try:
            for one in _KINDS[message.__msgtype__][1](self, topic, message, stamp):
                if self._source_of.get(type(one), topic) == topic:
                    yield one
        except ImageRefused as why:
            self._left_out[f"of {topic} are no image that can be used: {why}"] += 1
        except (ValueError, ArithmeticError):
            self._left_out[f"of {topic} hold what no sensor measures"] += 1

    def imu(self, topic: str, m: Any, stamp: Stamp) -> Iterator[Sample]:
        """Yield the readings and the attitude, each where the message has it."""
        turn = self._turns.get(_frame(m.header.frame_id))
        if turn is None:
            self._left_out[f"of {topic} are in the frame {m.header.frame_id!r}, which is not that of the others"] += 1
            return
        measures = topic not in self._still
        if measures and m.angular_velocity_covariance[0] != -1.0 and m.linear_acceleration_covariance[0] != -1.0:
            yield Imu(stamp, turn @ _vector(m.angular_velocity), turn @ _vector(m.linear_acceleration))
        q = m.orientation
        # A driver that knows no orientation says -1, or leaves all of it at zero or the identity.
        known = m.orientation_covariance[0] != -1.0 and (np.any(m.orientation_covariance) or any((q.x, q.y, q.z)))
        if known and abs(math.hypot(q.w, q.x, q.y, q.z) - 1.0) < 0.01:
            cov = turn @ np.asarray(m.orientation_covariance).reshape(3, 3) @ turn.T
            if not np.trace(cov) > 0.0:
                cov = np.diag([SIGMA_TILT_RAD**2, SIGMA_TILT_RAD**2, SIGMA_YAW_RAD**2])
            yield Attitude(stamp, Rotation(ENU_NED.T @ Rotation.from_quat([q.w, q.x, q.y, q.z]).matrix @ turn.T), cov)

    def range(self, topic: str, m: Any, stamp: Stamp) -> Iterator[Sample]:
        """Yield the distance below."""
        if not any(word in f"{topic} {m.header.frame_id}".lower() for word in _DOWN):
            self._left_out[f"of {topic} are ranges, and nothing shows that they look down (in the names of topic or frame)"] += 1
        elif m.min_range <= m.range <= (m.max_range or math.inf) and m.range > 0.0:
            yield Range(stamp, float(m.range), math.sqrt(v) if (v := getattr(m, "variance", 0.0)) > 0.0 else 0.02)
        else:
            self._left_out[f"of {topic} are ranges outside of the sensor's own limits"] += 1

    def velocity(self, topic: str, m: Any, stamp: Stamp) -> Iterator[Sample]:
        """Yield a velocity in the level frame; those in other frames are left out."""
        if m.header.frame_id != LEVEL:
            self._left_out[f"of {topic} are velocities in {m.header.frame_id!r} and not in {LEVEL!r}"] += 1
        elif min(m.twist.covariance[:15:7]) <= 0.0:
            self._left_out[f"of {topic} are velocities whose covariance says that they are not known"] += 1
        else:
            cov = UP @ np.asarray(m.twist.covariance).reshape(6, 6)[:3, :3] @ UP
            yield BodyVelocity(stamp, UP @ _vector(m.twist.twist.linear), cov)

    def image(self, topic: str, m: Any, stamp: Stamp) -> Iterator[Frame]:
        """Yield an image, raw or of a file's format."""
        px = image_px(m)
        self._frames += 1
        yield Frame(stamp, self._frames, px)


def _frame(name: str) -> str:
    """Return a frame's name without the stroke at its begin that ROS 1 allowed."""
    return name.lstrip("/")


def _is_body(frame: str) -> bool:
    """Return whether a frame is the body's, also that of one of several robots, as `drone_1/base_link`."""
    return frame.rpartition("/")[2] in _BODIES


def _vector(v: Any) -> F64:
    return np.array([v.x, v.y, v.z], float)


_KINDS: Final[Mapping[str, tuple[str, Callable[[_Import, str, Any, Stamp], Iterator[Sample | Frame]]]]] = {
    "sensor_msgs/msg/Imu": ("IMU", _Import.imu), "sensor_msgs/msg/Range": ("range", _Import.range),
    "sensor_msgs/msg/Image": ("camera", _Import.image), "sensor_msgs/msg/CompressedImage": ("camera", _Import.image),
    "geometry_msgs/msg/TwistWithCovarianceStamped": ("velocity", _Import.velocity),
}  # fmt: skip
_READ: Final = "read"
FIELDS: Final[Mapping[str, Mapping[str, str]]] = {
    "std_msgs/msg/Header": {
        "stamp": "read; of another clock, the time of writing stands for it",
        "frame_id": "read of all but images: whose axes an IMU has, whether a range looks down",
    },
    "sensor_msgs/msg/Imu": {
        "header": _READ,
        "orientation": "read; all 0, and the identity without a covariance, are none",
        "orientation_covariance": "read; -1 first is no orientation",
        "angular_velocity": "read; 0 in every message is no gyro",
        "angular_velocity_covariance": "read; -1 first is no rate",
        "linear_acceleration": "read; 0 in every message is no accelerometer",
        "linear_acceleration_covariance": "read; -1 first is no force",
    },
    "sensor_msgs/msg/Range": {
        "header": _READ,
        "radiation_type": "a distance is one by sound and by light",
        "field_of_view": "the estimator takes what is below, at any width",
        "min_range": _READ,
        "max_range": "read; 0 is no limit",
        "range": "read; infinite, 0 and beyond the limits is none",
        "variance": "read; 0 is none, and of ROS 1 there is none",
    },
    "sensor_msgs/msg/Image": {
        "header": _READ,
        **dict.fromkeys(("height", "width", "encoding", "is_bigendian", "step", "data"), _READ),
    },
    "sensor_msgs/msg/CompressedImage": {
        "header": _READ,
        "format": "read to know depths; the data say what they are",
        "data": _READ,
    },
    "geometry_msgs/msg/TwistWithCovarianceStamped": {"header": _READ, "twist": "read; a covariance of 0 or -1 is no velocity"},
    "tf2_msgs/msg/TFMessage": {"transforms": "read of /tf_static alone: what moves turns no sensor of the body"},
}
"""Every field of the messages that are read: read, with what means that nothing was measured, or why not."""
