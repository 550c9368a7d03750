"""Bags of ROS 1 and 2 as a recording: our own export comes back as it was, and what is not read is told."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.cli import main as cli
from companion.recording.reading import RecordedFrame, open_recording
from companion.tools.ros2 import bags
from drivers.imports.kinds import FileKind, kind_of
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Attitude, BodyVelocity, Frame, Imu, Range
from tests.fly import record_to

rosbags = pytest.importorskip("rosbags", reason="needs the extra ros2")
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


def test_a_bag_of_ros_1_is_read_in_our_axes(tmp_path: Path) -> None:
    path = tmp_path / "flight.bag"
    write_ros1(path)
    path = path.rename(tmp_path / "no-ending")
    reported: list[str] = []
    assert kind_of(path) is FileKind.ROS_BAG
    found = list(bags.read(path, reported.append))
    imus = [one for one in found if isinstance(one, Imu)]
    assert len(imus) == 199, "the first was measured before the bag began"
    assert {tuple(one.w_body) for one in imus} == {(0.1, -0.2, -0.3)}, "of one IMU alone"
    assert imus[0].f_body.tolist() == [0.0, 0.0, -9.81]
    assert imus[50].stamp.received_at - imus[50].stamp.measured_at == 10_000_000
    attitude = next(one for one in found if isinstance(one, Attitude))
    # A quarter of a turn to the left from east is north.
    assert np.degrees(attitude.R_ned_body.rpy_rad) == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert [one.range_m for one in found if isinstance(one, Range)] == pytest.approx([3.0 - n / 10 for n in range(1, 20)])
    frames = [one for one in found if isinstance(one, Frame)]
    assert [one.px[0, 0].tolist() for one in frames] == [[255, 0, 10 * n] for n in range(1, 20)]
    assert any("/front/range" in text for text in reported)


def test_headers_of_another_clock_are_reported_and_not_accepted(tmp_path: Path) -> None:
    write_ros1(tmp_path / "a.bag", late_s=400.0)
    reported: list[str] = []
    found = list(bags.read(tmp_path / "a.bag", reported.append))
    assert all(one.stamp.measured_at == one.stamp.received_at for one in found)
    assert any("another clock" in text for text in reported)


def test_our_own_bag_comes_back_as_it_was(tmp_path: Path) -> None:
    flown, bag, again = tmp_path / "a.mcap", tmp_path / "bag", tmp_path / "b.mcap"
    record_to(flown, seconds=0.6)
    assert cli.main(["record", "export", str(flown), "--format", "ros2", "--output", str(bag)]) == 0
    assert cli.main(["record", "import", str(bag), "--config", "sim", "--output", str(again)]) == 0
    kinds = (Imu, Attitude, BodyVelocity, Range)
    before, after = ([e for e in open_recording([path]).events() if isinstance(e, kinds)] for path in (flown, again))
    zeros = []
    for kind in kinds:
        other = [e for e in after if isinstance(e, kind)]
        one = [e for e in before if isinstance(e, kind)][-len(other) :]  # the bag begins after the first were measured
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
