"""A recording as a ROS 2 bag and a flight as its topics, and bags as a recording."""

import asyncio
import json
import math
import os
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.observer import Decision
from companion.cli import main as cli
from companion.facts.records import TruthRecord
from companion.recording.reading import RecordedFrame, open_recording
from companion.tools.ros2 import bags
from companion.tools.ros2.messages import RosMessages
from drivers.file_kinds import FileKind, kind_of
from drivers.ros2 import typestore
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, BodyVelocity, Frame, Imu, Range, VesselMotion, VesselReport, VesselWind
from estimator.contracts.time import MonoNs, Stamp
from tests.companion.live.test_live import TOKEN, serve_live
from tests.fly import record_to
from tests.support.waiting import until

rosbags = pytest.importorskip("rosbags", reason="needs the extra ros2")
Bag = dict[str, list[tuple[int, Any]]]


@pytest.fixture(scope="module")
def exported(flight_file: Path) -> Path:
    folder = flight_file.parent / "bag"
    assert cli.main(["record", "export", str(flight_file), "--format", "ros2", "--output", str(folder)]) == 0
    return folder


def read(folder: Path) -> Bag:
    from rosbags.highlevel import AnyReader

    out: Bag = defaultdict(list)
    with AnyReader([folder]) as reader:
        for connection, at, data in reader.messages():
            out[connection.topic].append((at, reader.deserialize(data, connection.msgtype)))
    return out


@pytest.fixture(scope="module")
def messages(exported: Path) -> Bag:
    return read(exported)


def xyz(v: Any) -> list[float]:
    return [v.x, v.y, v.z]


def rotation(q: Any) -> Rotation:
    return Rotation.from_quat([q.w, q.x, q.y, q.z])


def test_samples_have_the_axes_of_ros_and_the_time_of_their_measurement(flight_file: Path, messages: Bag) -> None:
    events = list(open_recording([flight_file]).events())
    imus = [e for e in events if isinstance(e, Imu)]
    assert len(messages["/imu/data_raw"]) == len(imus) > 100
    for (at, message), imu in zip(messages["/imu/data_raw"], imus, strict=True):
        assert at == imu.stamp.received_at
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == imu.stamp.measured_at
        forward, right, down = imu.f_body
        assert xyz(message.linear_acceleration) == [forward, -right, -down]
        assert xyz(message.angular_velocity) == (imu.w_body * [1.0, -1.0, -1.0]).tolist()
        assert message.orientation_covariance[0] == -1.0
    assert np.mean([m.linear_acceleration.z for _, m in messages["/imu/data_raw"]]) == pytest.approx(9.81, abs=1.5)
    attitudes = [e for e in events if isinstance(e, Attitude)]
    for (_, message), attitude in zip(messages["/imu/data"], attitudes, strict=True):
        nose = rotation(message.orientation) @ np.array([1.0, 0.0, 0.0])
        north, east, down = attitude.R_ned_body @ np.array([1.0, 0.0, 0.0])
        assert nose == pytest.approx([east, north, -down], abs=1e-9)
        left = rotation(message.orientation) @ np.array([0.0, 1.0, 0.0])
        north, east, down = attitude.R_ned_body @ np.array([0.0, -1.0, 0.0])
        assert left == pytest.approx([east, north, -down], abs=1e-9)
    ranges = [e.range_m for e in events if isinstance(e, Range)]
    assert [m.range for _, m in messages["/range"]] == pytest.approx(ranges, rel=1e-6)


def test_the_camera_of_the_transforms_sees_the_pad_where_the_service_does(flight_file: Path, messages: Bag) -> None:
    recording = open_recording([flight_file])
    camera = recording.camera()
    assert camera is not None
    fixed = {t.child_frame_id: t.transform for t in messages["/tf_static"][0][1].transforms}
    mount, beam = fixed["camera_optical_frame"], fixed["range_down"]
    assert rotation(beam.rotation) @ np.array([1.0, 0.0, 0.0]) == pytest.approx([0.0, 0.0, -1.0], abs=1e-12)
    newest: dict[str, Any] = {}
    seen: dict[int, np.ndarray] = {}
    for at, message in messages["/tf"]:
        newest.update({t.child_frame_id: t.transform for t in message.transforms})
        if message.transforms[0].child_frame_id == "base_stabilized" and "base_link" in newest:
            level, body = newest["base_stabilized"], newest["base_link"]
            in_level = rotation(level.rotation).inv @ -np.array(xyz(level.translation))
            in_body = rotation(body.rotation).inv @ in_level
            seen[at] = rotation(mount.rotation).inv @ (in_body - np.array(xyz(mount.translation)))
    checked = 0
    attitude: Attitude | None = None
    for event in recording.events():
        if isinstance(event, Attitude):
            attitude = event
        elif isinstance(event, Decision) and event.belief is not None and event.at in seen and attitude is not None:
            d_body = attitude.R_ned_body.without_heading().inv @ event.belief.d_body_pad_level
            # A bag does not say which of an attitude and a decision of the same instant came first.
            assert seen[event.at] == pytest.approx(camera.T_body_cam.inv @ d_body, abs=0.05)
            checked += 1
    assert checked > 20
    info = messages["/camera/camera_info"][0][1]
    assert info.k.tolist() == camera.K.ravel().tolist()
    assert info.header.frame_id == "camera_optical_frame"


def test_a_camera_on_a_gimbal_is_turned_with_each_frame(flight_file: Path) -> None:
    recording = open_recording([flight_file])
    camera = recording.camera()
    frame = next(e for e in recording.events() if isinstance(e, RecordedFrame))
    held = camera.T_body_cam.R @ Rotation.from_rpy(0.2, -0.1, 0.3)
    turned = RecordedFrame(replace(frame.record, R_body_cam=held.matrix.ravel().tolist()), None)
    ros = RosMessages(typestore(), 0, camera, gimballed=True)
    (_, _, _, fixed), (topic, _, _, message), *_ = ros.of(turned)
    assert [t.child_frame_id for t in fixed.transforms] == ["range_down"]
    (transform,) = message.transforms
    assert (topic, transform.header.frame_id, transform.child_frame_id) == ("/tf", "base_link", "camera_optical_frame")
    axis = held @ np.array([0.0, 0.0, 1.0])
    assert rotation(transform.transform.rotation) @ np.array([0.0, 0.0, 1.0]) == pytest.approx([axis[0], -axis[1], -axis[2]])
    assert all(topic != "/tf" for topic, *_ in ros.of(frame))


def test_estimates_carry_their_covariance_into_the_axes_of_ros(flight_file: Path, messages: Bag) -> None:
    """The covariance of the place in `deck` is checked against a cloud drawn from the estimate's own."""
    decisions = [e for e in open_recording([flight_file]).events() if isinstance(e, Decision) and e.belief is not None]
    by_time = dict(messages["/dead_reckoning/odometry"])
    decision = next(d for d in reversed(decisions) if d.at in by_time and d.belief.yaw_rad is not None)
    belief, message = decision.belief, by_time[decision.at]
    rng = np.random.default_rng(1)
    cov = belief.cov + np.diag([0.0] * 6 + [1e-4])
    drawn = rng.multivariate_normal(np.r_[belief.d_body_pad_level, belief.v_pad_level, belief.yaw_rad], cov, 40_000)
    c, s = np.cos(drawn[:, 6]), np.sin(drawn[:, 6])
    # In `pad` (x along the arrow, y to starboard, z down) the body is at -Rz(yaw) d; `deck` has y to port and z up.
    place = np.stack([-(c * drawn[:, 0] - s * drawn[:, 1]), s * drawn[:, 0] + c * drawn[:, 1], drawn[:, 2]], axis=1)
    from companion.tools.ros2.messages import level_in_deck

    at, found = level_in_deck(belief.d_body_pad_level, belief.yaw_rad, cov)
    assert at == pytest.approx(xyz(message.pose.pose.position), abs=1e-12)
    assert at == pytest.approx(place.mean(axis=0), abs=0.02)
    cloud = np.cov(np.c_[place, -drawn[:, 6]].T)
    keep = np.ix_([0, 1, 2, 5], [0, 1, 2, 5])
    sigma = np.sqrt(np.diag(cloud))
    assert found[keep] / np.outer(sigma, sigma) == pytest.approx(cloud / np.outer(sigma, sigma), abs=0.05)
    assert xyz(message.twist.twist.linear) == (belief.v_pad_level * [-1.0, 1.0, 1.0]).tolist()
    assert message.pose.covariance.reshape(6, 6)[3, 3] == pytest.approx(math.pi**2 / 3.0)
    pads = dict(messages["/dead_reckoning/pad_pose"])
    pad = pads[decision.at].pose
    assert xyz(pad.pose.position) == (belief.d_body_pad_level * [1.0, -1.0, -1.0]).tolist()
    assert rotation(pad.pose.orientation).rpy_rad[2] == pytest.approx(belief.yaw_rad, abs=1e-9)
    assert pad.covariance.reshape(6, 6)[0, 5] == belief.cov[0, 6]
    assert pad.covariance.reshape(6, 6)[1, 5] == -belief.cov[1, 6]
    truths = [e for e in open_recording([flight_file]).events() if isinstance(e, TruthRecord)]
    assert all(
        m.pose.pose.position.z == pytest.approx(t.d_body_pad_level[2])
        for (_, m), t in zip(messages["/truth/odometry"], truths, strict=True)
    )


def test_images_are_those_of_the_recording_and_a_video_is_decoded(flight_file: Path, messages: Bag, tmp_path: Path) -> None:
    frames = [e for e in open_recording([flight_file]).events() if isinstance(e, RecordedFrame) and e.image is not None]
    assert [bytes(m.data) for _, m in messages["/camera/image_raw/compressed"]] == [f.image for f in frames]
    assert messages["/camera/image_raw/compressed"][0][1].format == "bgr8; jpeg compressed bgr8"
    filmed = tmp_path / "video.mcap"
    record_to(filmed, seconds=0.4, frames="h264")
    bags.export(open_recording([filmed]), tmp_path / "bag")
    images = read(tmp_path / "bag")["/camera/image_raw/compressed"]
    first = cv2.imdecode(images[0][1].data, cv2.IMREAD_COLOR)
    exact = cv2.imdecode(np.frombuffer(bytes(frames[0].image), np.uint8), cv2.IMREAD_COLOR)
    assert np.mean(np.abs(first.astype(float) - exact)) < 8.0


def test_what_does_not_change_is_kept_for_late_subscribers(exported: Path) -> None:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import QosDurability

    with AnyReader([exported]) as reader:
        kept = {
            c.topic
            for c in reader.connections
            if any(q.durability is QosDurability.TRANSIENT_LOCAL for q in c.ext.offered_qos_profiles)
        }
    assert kept == {"/tf_static"}


def test_a_torn_recording_is_exported_as_far_as_it_goes(flight_file: Path, tmp_path: Path, messages: Bag) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(flight_file.read_bytes()[:-20_000])
    counts = bags.export(open_recording([torn]), tmp_path / "bag")
    assert 0 < counts["/imu/data_raw"] <= len(messages["/imu/data_raw"])
    assert {topic: len(found) for topic, found in read(tmp_path / "bag").items()} == counts


def test_nothing_is_overwritten_and_a_bag_that_failed_leaves_nothing(flight_file, tmp_path, capsys, monkeypatch):
    (tmp_path / "mine").mkdir()
    command = ["record", "export", str(flight_file), "--format", "ros2", "--output"]
    assert cli.main([*command, str(tmp_path / "mine")]) == 2
    assert f"{tmp_path / 'mine'}: exists already" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert cli.main([*command, str(tmp_path / "file/bag")]) == 2
    assert "file/bag: Not a directory" in capsys.readouterr().err

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(bags._Bag, "close", full)
    assert cli.main([*command, str(tmp_path / "new")]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


GOLDEN = Path(__file__).parents[2] / "golden/frames.mcap"


def test_without_the_library_one_line_says_how_to_get_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("drivers.extras.find_spec", lambda name: None if name == "rosbags" else name)
    assert cli.main(["record", "export", str(GOLDEN), "--format", "ros2", "--output", str(tmp_path / "bag")]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    assert "decklander[ros2]" in printed
    assert not (tmp_path / "bag").exists()


BEGAN_NS = 1_700_000_000_000_000_000


def write_ros1(path: Path, *, late_s: float = 0.01, seconds: int = 2) -> None:
    """Write a bag of ROS 1 with an IMU of 100 Hz that turns, a camera of 10 Hz that brightens, and a range ahead.

    Beside the IMU its raw readings stand at 50 Hz, and beside the camera its depths.
    """
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    types: Any = store.types
    with Writer(path) as bag:
        made = {
            topic: (bag.add_connection(topic, f"sensor_msgs/msg/{kind}", typestore=store), f"sensor_msgs/msg/{kind}")
            for topic, kind in (
                ("/imu/data", "Imu"),
                ("/imu/data_raw", "Imu"),
                ("/cam0/depth", "Image"),
                ("/cam0/image_raw", "Image"),
                ("/front/range", "Range"),
                ("/alt/down", "Range"),
            )
        }

        def add(topic: str, at: int, **fields: Any) -> None:
            stamp = types["builtin_interfaces/msg/Time"](*divmod(at - round(late_s * 1e9), 10**9))
            connection, kind = made[topic]
            header = types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id=topic[1:])
            bag.write(connection, at, store.serialize_ros1(types[kind](header=header, **fields), kind))

        vector, turned = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
        for n in range(100 * seconds):
            at = BEGAN_NS + n * 10_000_000
            readings = {} if n % 2 else {"/imu/data_raw": -1.0}
            for topic, known in {"/imu/data": 1e-4, **readings}.items():
                add(
                topic, at,
                orientation=turned(0.0, 0.0, np.sin(np.pi / 4), np.cos(np.pi / 4)),
                orientation_covariance=np.diag([known] * 3).ravel(),
                angular_velocity=vector(0.1, 0.2, 0.3 if known > 0 else 9.0), angular_velocity_covariance=np.zeros(9),
                linear_acceleration=vector(0.0, 0.0, 9.81), linear_acceleration_covariance=np.zeros(9),
            )  # fmt: skip
            if n % 5 == 0:
                add("/cam0/depth", at, height=1, width=1, encoding="32FC1", is_bigendian=0, step=4, data=np.zeros(4, np.uint8))
            if n % 10 == 0:
                px = np.full((24, 32, 3), (n, 0, 255), np.uint8)
                add("/cam0/image_raw", at, height=24, width=32, encoding="rgb8", is_bigendian=0, step=96, data=px.ravel())
                for topic, far_m in (("/front/range", 8.0), ("/alt/down", 3.0 - n / 100)):
                    add(topic, at, radiation_type=1, field_of_view=0.1, min_range=0.1, max_range=30.0, range=far_m)


@pytest.mark.parametrize(
    "topics", [("rect/image", "image_raw", "annotated/image"), ("detections", "down/image_raw", "image_rect")]
)
def test_of_several_cameras_the_raw_one_is_read_or_the_one_that_is_named(tmp_path: Path, topics: tuple[str, ...]) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS1_NOETIC), "sensor_msgs/msg/Image"
    types: Any = store.types
    folder = tmp_path / "bags"
    folder.mkdir()
    for part in range(2):
        with Writer(folder / f"{part}.bag") as bag:
            made = [bag.add_connection(f"/{topic}", kind, typestore=store) for topic in topics]
            for n, (connection, light) in enumerate([(c, 80 * i) for i, c in enumerate(made)] * 3):
                at = BEGAN_NS + part * 10**9 + n * 10**7
                header = types["std_msgs/msg/Header"](0, types["builtin_interfaces/msg/Time"](*divmod(at, 10**9)), "cam")
                px = np.full(12, light, np.uint8)
                image = types[kind](header=header, height=3, width=4, encoding="mono8", is_bigendian=0, step=4, data=px)
                bag.write(connection, at, store.serialize_ros1(image, kind))
    reported: list[str] = []
    assert kind_of(folder) is FileKind.ROS_BAG, "without metadata"
    frames = [one for one in bags.read(folder, reported.append) if isinstance(one, Frame)]
    assert (len(frames), {int(one.px.max()) for one in frames}) == (6, {80})
    assert any("--topic reads another" in line for line in reported)
    named = [one for one in bags.read(folder, reported.append, f"/{topics[2]}") if isinstance(one, Frame)]
    assert {int(one.px.max()) for one in named} == {160}
    with pytest.raises(BadInput, match="none of its cameras"):
        list(bags.read(folder, reported.append, "/nosuch"))


@pytest.mark.parametrize("late_s", [0.01, 0.8])
def test_a_bag_of_ros_1_is_read_whole_and_in_our_axes(tmp_path: Path, late_s: float) -> None:
    path = tmp_path / "flight.bag"
    write_ros1(path, late_s=late_s)
    path = path.rename(tmp_path / "no-ending")
    reported: list[str] = []
    assert kind_of(path) is FileKind.ROS_BAG
    found = list(bags.read(path, reported.append))
    imus = [one for one in found if isinstance(one, Imu)]
    assert len(imus) == 200, "with what was measured before the bag began"
    assert {tuple(one.w_body) for one in imus} == {(0.1, -0.2, -0.3)}, "of one IMU alone"
    assert imus[0].f_body.tolist() == [0.0, 0.0, -9.81]
    assert (imus[0].stamp.measured_at, imus[50].stamp.received_at - imus[50].stamp.measured_at) == (0, late_s * 1e9)
    attitude = next(one for one in found if isinstance(one, Attitude))
    # A quarter of a turn to the left from east is north.
    assert np.degrees(attitude.R_ned_body.rpy_rad) == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert [one.range_m for one in found if isinstance(one, Range)] == pytest.approx([3.0 - n / 10 for n in range(20)])
    frames = [one for one in found if isinstance(one, Frame)]
    assert [one.px[0, 0].tolist() for one in frames] == [[255, 0, 10 * n] for n in range(20)]
    assert any("/front/range" in text for text in reported)


def test_headers_of_another_clock_are_reported_and_not_accepted(tmp_path: Path) -> None:
    write_ros1(tmp_path / "a.bag", late_s=400.0)
    reported: list[str] = []
    found = list(bags.read(tmp_path / "a.bag", reported.append))
    assert all(one.stamp.measured_at == one.stamp.received_at for one in found)
    assert any("another clock" in text for text in reported)


def write_imus(path: Path, imus: dict[str, tuple[str, Any, Any]], joined: dict[tuple[str, str], Rotation]) -> Path:
    """Write a bag of ROS 2 with IMUs, each (frame, rate, force) by its topic, and /tf_static's turns by parent and child."""
    from rosbags.rosbag2 import Writer

    store, types = typestore(), typestore().types
    vector, turned = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]

    def header(n: int, frame: str) -> Any:
        stamp = types["builtin_interfaces/msg/Time"](*divmod(BEGAN_NS + n * 10_000_000, 10**9))
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)

    transforms = []
    for (parent, child), turn in joined.items():
        w, x, y, z = turn.quat_wxyz
        move = types["geometry_msgs/msg/Transform"](translation=vector(0.1, 0.0, 0.0), rotation=turned(x, y, z, w))
        transforms.append(types["geometry_msgs/msg/TransformStamped"](header(0, parent), child, move))
    with Writer(path, version=8) as bag:
        fixed = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/Imu"
        links = {
            topic: bag.add_connection(topic, fixed[topic != "/tf_static"], typestore=store) for topic in ("/tf_static", *imus)
        }
        bag.write(links["/tf_static"], BEGAN_NS, store.serialize_cdr(types[fixed[0]](transforms), fixed[0]))
        for n in range(20):
            for topic, (frame, rate, force) in imus.items():
                message = types[fixed[1]](
                    header(n, frame), turned(0.0, 0.0, 0.0, 1.0), np.diag([-1.0, 0.0, 0.0]).ravel(),
                    vector(*map(float, rate)), np.zeros(9), vector(*map(float, force)), np.zeros(9),
                )  # fmt: skip
                bag.write(links[topic], BEGAN_NS + n * 10_000_000, store.serialize_cdr(message, fixed[1]))
    return path


RATE, FORCE = np.array([0.1, 0.2, 0.3]), np.array([0.5, 0.0, 9.8])


@pytest.mark.parametrize("seed", range(6))
def test_an_imu_in_a_sensor_s_axes_is_turned_by_the_chain_to_the_body(seed: int, tmp_path: Path) -> None:
    mount, lens = (Rotation.from_quat(q) for q in np.random.default_rng(seed).normal(size=(2, 4)))
    # A tree may stand on its head: a camera's own launch file has the body below the camera.
    joined = {("drone/base_link", "cam"): mount} if seed % 2 else {("/cam", "drone/base_link"): mount.inv}
    turn = (mount @ lens).inv
    imus = {"/cam/imu": ("cam_imu_optical", turn @ RATE, turn @ FORCE)}
    bag = write_imus(tmp_path / "bag", imus, {("cam", "cam_imu_optical"): lens, **joined})
    found = [one for one in bags.read(bag, lambda text: None) if isinstance(one, Imu)]
    assert len(found) == 20
    assert np.allclose([found[3].w_body, found[3].f_body], [[0.1, -0.2, -0.3], [0.5, 0.0, -9.8]])


@pytest.mark.parametrize(
    ("rate", "force", "says"),
    [(RATE, FORCE, "read as forward, left and up"), (RATE, -FORCE, "and not up"), (RATE, FORCE[::-1], "and not up"),
     (0 * RATE, FORCE, "all its rates are exactly 0"), (RATE, 0 * FORCE, "all its forces are exactly 0")],
)  # fmt: skip
def test_an_imu_whose_axes_nothing_says_is_read_only_where_it_stands_as_the_body(rate, force, says, tmp_path: Path) -> None:
    taken = "read as" in says
    for name, beside in (("alone", {}), ("beside", {"/imu": ("base_link", 2 * RATE, FORCE)})):
        reported: list[str] = []
        bag = write_imus(tmp_path / name, {"/cam/imu": ("cam_imu", rate, force), **beside}, {})
        if taken or beside:
            found = [one for one in bags.read(bag, reported.append) if isinstance(one, Imu)]
            assert {tuple(one.w_body) for one in found} == {(0.1, -0.2, -0.3) if taken else (0.2, -0.4, -0.6)}
        else:
            with pytest.raises(BadInput, match="no IMU"):
                list(bags.read(bag, reported.append))
        assert any(says in text for text in reported)


@pytest.mark.parametrize(
    ("limits", "far_m", "var", "given"),
    [((0.1, 9.0), 3.0, 0.01, 2), ((0.0, 0.0), 3.0, 0.01, 2), ((0.1, 9.0), 0.0, 0.01, 1), ((0.0, 0.0), 0.0, 0.01, 1),
     ((0.1, 9.0), 3.0, 0.0, 1), ((0.1, 9.0), 3.0, -1.0, 1)],
)  # fmt: skip
def test_what_a_range_or_a_velocity_does_not_know_is_no_measurement(limits, far_m, var, given, tmp_path: Path) -> None:
    from rosbags.rosbag2 import Writer

    store, types = typestore(), typestore().types
    vector, twist, kind = (
        types["geometry_msgs/msg/Vector3"],
        "geometry_msgs/msg/TwistWithCovarianceStamped",
        "sensor_msgs/msg/Range",
    )
    stamp = types["builtin_interfaces/msg/Time"](*divmod(BEGAN_NS, 10**9))
    moved = types["geometry_msgs/msg/Twist"](vector(1.0, 0.0, 0.0), vector(0.0, 0.0, 0.0))
    moved = types["geometry_msgs/msg/TwistWithCovariance"](moved, np.diag([var] * 6).ravel())
    made = {
        twist: types[twist](types["std_msgs/msg/Header"](stamp, "base_stabilized"), moved),
        kind: types[kind](types["std_msgs/msg/Header"](stamp, "range_down"), 1, 0.1, *limits, far_m, 0.0),
    }
    with Writer(tmp_path / "bag", version=8) as bag:
        for name, message in made.items():
            link = bag.add_connection(f"/{name[-5:]}", name, typestore=store)
            bag.write(link, BEGAN_NS, store.serialize_cdr(message, name))
    assert len(list(bags.read(tmp_path / "bag", lambda text: None))) == given


def test_every_field_of_a_bag_s_messages_has_its_row_and_what_is_read_is_what_it_says(flight_file, tmp_path, monkeypatch) -> None:
    from rosbags.highlevel import AnyReader

    seen: dict[str, set[str]] = defaultdict(set)

    class Spied:
        def __init__(self, of: Any) -> None:
            self.of = of

        def __getattr__(self, name: str) -> Any:
            if name == "__msgtype__":
                return self.of.__msgtype__
            found = getattr(self.of, name)
            seen[self.of.__msgtype__].add(name)
            return Spied(found) if name == "header" else found

    for kind, rows in bags.FIELDS.items():
        assert list(rows) == [name for name, _ in typestore().get_msgdef(kind).fields], kind
    write_ros1(tmp_path / "a.bag", seconds=1)
    assert cli.main(["record", "export", str(flight_file), "--format", "ros2", "--output", str(tmp_path / "b")]) == 0
    deserialize = AnyReader.deserialize
    monkeypatch.setattr(AnyReader, "deserialize", lambda *of: Spied(deserialize(*of)))
    for path in (tmp_path / "a.bag", tmp_path / "b"):
        assert list(bags.read(path, lambda text: None))
    for kind, rows in bags.FIELDS.items():
        assert seen[kind] == {name for name, row in rows.items() if row.startswith("read")}, kind
    assert set(seen) == set(bags.FIELDS), "no message is read without its rows"


def test_our_own_bag_comes_back_as_it_was(tmp_path: Path) -> None:
    flown, bag, again = tmp_path / "a.mcap", tmp_path / "bag", tmp_path / "b.mcap"
    record_to(flown, seconds=0.6)
    assert cli.main(["record", "export", str(flown), "--format", "ros2", "--output", str(bag)]) == 0
    assert cli.main(["record", "import", str(bag), "--config", "sim", "--output", str(again)]) == 0
    kinds = (Imu, Attitude, BodyVelocity, Range)
    before, after = ([e for e in open_recording([path]).events() if isinstance(e, kinds)] for path in (flown, again))
    zeros = []
    for kind in kinds:
        one, other = ([e for e in events if isinstance(e, kind)] for events in (before, after))
        zeros += [a.stamp.measured_at - b.stamp.measured_at for a, b in zip(one, other, strict=True)]
        for a, b in zip(one, other, strict=True):
            if isinstance(a, Imu) and isinstance(b, Imu):
                assert np.allclose([a.w_body, a.f_body], [b.w_body, b.f_body])
            if isinstance(a, Attitude) and isinstance(b, Attitude):
                assert np.allclose(a.R_ned_body.matrix, b.R_ned_body.matrix)
    assert len(zeros) > 300
    assert max(zeros) - min(zeros) < 2000, "ns: a bag's own time is read in microseconds"
    assert sum(isinstance(e, RecordedFrame) for e in open_recording([again]).events()) > 5


@pytest.mark.parametrize("n", range(12))
def test_a_damaged_bag_is_refused_or_reported(n: int, tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    write_ros1(path, seconds=1)
    whole = list(bags.read(path, lambda text: None))
    rng, data = np.random.default_rng(n), bytearray(path.read_bytes())
    at = int(rng.integers(13, len(data) - 300))
    data[at : at + 200] = b"" if n % 3 == 0 else rng.bytes(200) if n % 3 == 1 else b"\xff" * 200
    path.write_bytes(data)
    reported: list[str] = []
    found: list[object] = []
    try:
        found = list(bags.read(path, reported.append))
    except BadInput as why:
        reported.append(str(why))
    assert reported or len(found) == len(whole)
    assert all("\n" not in text for text in reported)


def test_a_ship_s_own_sensors_have_the_axes_of_ros() -> None:
    """Port side down, bow up, 0.5 m below her mean, turning to starboard, in a wind from the east."""
    ros, stamp = RosMessages(typestore(), 0, None), Stamp(MonoNs(10**9), MonoNs(10**9), 0.1, "arrival")
    moved = VesselMotion(stamp, "IN PSXN", -0.1, 0.2, 0.0, 0.5)
    turned = VesselReport(stamp, None, None, None, None, 0.3, 0.01)
    sent = {
        topic: message
        for one in (moved, turned, VesselWind(stamp, "WI MWD", 0.5 * math.pi, 8.0))
        for topic, *_, message in ros.of(one)
    }
    deck = rotation(sent["/vessel/tilt"].quaternion)
    assert deck @ np.array([1.0, 0.0, 0.0]) == pytest.approx([math.cos(0.2), 0.0, math.sin(0.2)]), "the bow is up"
    assert (deck @ np.array([0.0, 1.0, 0.0]))[2] < -0.09, "and port, which is left, is down"
    assert sent["/vessel/tilt"].header.frame_id == "IN PSXN"
    assert (sent["/vessel/heave"].vector.z, sent["/vessel/turn"].vector.z) == (-0.5, -0.3)
    wind = sent["/vessel/wind"].vector
    assert (wind.x, wind.y) == pytest.approx((-8.0, 0.0), abs=1e-9)
    assert list(ros.of(replace(moved, roll_rad=None, heave_down_m=None))) == []


pytest.importorskip("rosbags", reason="needs the extra ros2")
STAND_IN = Path(__file__).parents[2] / "support/stand_in_ros"
WORDS = [sys.executable, "-m", "companion.cli.main", "ros2"]


def published(path: Path) -> dict[str, list[Any]]:
    """Read what was published, by the library that ROS users read messages with."""
    from rosbags.typesys import Stores, get_typestore

    store, out = get_typestore(Stores.ROS2_JAZZY), defaultdict(list)
    for line in path.read_text().splitlines():
        output = json.loads(line)
        assert (output["durability"] == "TRANSIENT_LOCAL") is (output["topic"] == "/tf_static")
        out[output["topic"]].append(store.deserialize_cdr(bytes.fromhex(output["cdr"]), output["kind"]))
    return out


@contextmanager
def started(address: str, file: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    environment = {**os.environ, "PYTHONPATH": f"{STAND_IN}:{Path.cwd()}", "STAND_IN_ROS": str(file)}
    with subprocess.Popen([*WORDS, address, *words], stderr=subprocess.PIPE, text=True, env=environment) as bridge:
        try:
            yield bridge
        finally:
            bridge.kill()


async def test_a_flight_is_published_while_it_is_flown_and_again_after_the_service_was_gone(tmp_path: Path) -> None:
    file, token = tmp_path / "published", tmp_path / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    with ExitStack() as stack:
        async with serve_live(token_file=str(token)) as service:
            bridge = stack.enter_context(started(service.address, file, "--token-file", str(token), "--config", "sim"))
            await until(lambda: service.counted("viewers") == 1)
            await service.fly(4.0)
            await until(lambda: file.exists() and b"/rosout" in file.read_bytes())
            port = service.server.port
        before = file.read_bytes().count(b"/tf_static")
        token.write_text(TOKEN[::-1])
        async with serve_live(token_file=str(token), port=port) as again:
            await until(lambda: again.counted("viewers") == 1)
            await again.fly(0.5)
            await until(lambda: file.read_bytes().count(b"/tf_static") > before)
        bridge.terminate()
        _, output = await asyncio.to_thread(bridge.communicate, timeout=30)
    assert bridge.returncode == 143
    assert "connected to 'drone'" in output
    assert "trying again" in output
    assert "this ROS has no diagnostic_msgs/msg/DiagnosticArray; the topic is left out" in output
    assert re.search(r"[1-9]\d+ messages on \d+ topics; 0 of the service not understood", output)
    topics = published(file)
    wanted = {"imu/data", "velocity", "range", "camera/image_raw/compressed", "camera/camera_info", "detection/pad_pose"}
    wanted |= {"dead_reckoning/pad_pose", "cmd_vel", "phase", "markers"}
    assert {"/tf", "/tf_static", *(f"/decklander/{name}" for name in wanted)} <= set(topics)
    assert {t.child_frame_id for t in topics["/tf_static"][0].transforms} == {"camera_optical_frame", "range_down"}
    gravity = topics["/decklander/imu/data_raw"][0].linear_acceleration
    assert gravity.z == pytest.approx(9.81, abs=1.5)
    pose = topics["/decklander/dead_reckoning/pad_pose"][-1]
    assert pose.header.frame_id == "base_stabilized"
    assert pose.pose.pose.position.z < -0.5, "the pad is below, and z is up"
    assert np.isfinite(pose.pose.covariance).all()


async def test_a_wrong_token_ends_it_and_nobody_there_is_waited_for(tmp_path: Path) -> None:
    token = tmp_path / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    async with serve_live(token_file=str(token)) as service:
        address = service.address
        with started(address, tmp_path / "published") as bridge:
            _, output = await asyncio.to_thread(bridge.communicate, timeout=60)
        assert (bridge.returncode, "the token is missing or wrong (--token-file)" in output) == (2, True)
    with started(address, tmp_path / "published", "--seconds", "2.5") as bridge:
        _, output = await asyncio.to_thread(bridge.communicate, timeout=60)
    assert bridge.returncode == 1
    assert output.count("trying again") == 1, "said once"
