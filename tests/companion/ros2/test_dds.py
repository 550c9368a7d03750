"""A flight seen and ordered by the DDS library from another process than the command's, by both middlewares, and a camera."""

import asyncio
import os
import re
import subprocess
import sys
import time
from importlib import import_module
from importlib.util import find_spec
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from companion.base.mission import FlightOutcome
from companion.cli.main import main
from companion.parts.operator.client import socket_path
from companion.parts.operator.local_socket import OperatorSocket
from companion.settings.load import load
from drivers import ros2
from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions
from drivers.clock import SystemClock
from tests.companion.live.test_live import serve_live
from tests.support.waiting import free_port, until

pytest.importorskip("cyclonedds", reason="needs the extra ros2")
pytest.importorskip("rosbags", reason="needs the extra ros2")
from cyclonedds import core, domain, idl, pub, sub, topic

LOOPBACK = (
    '<General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces><AllowMulticast>false</AllowMulticast>'
    '</General><Discovery><Peers><Peer address="127.0.0.1"/></Peers><ParticipantIndex>auto</ParticipantIndex></Discovery>'
    "<Compatibility><IgnoreTypeInformation>1.15,1.16</IgnoreTypeInformation></Compatibility>"
)
# Written by hand from the definitions of ROS, in the order of their use.
DEFINITIONS = """builtin_interfaces.msg Time int32 sec, uint32 nanosec; std_msgs.msg Header Time stamp, str frame_id
geometry_msgs.msg Vector3 float64 x, float64 y, float64 z; geometry_msgs.msg Point float64 x, float64 y, float64 z
geometry_msgs.msg Quaternion float64 x, float64 y, float64 z, float64 w
geometry_msgs.msg Transform Vector3 translation, Quaternion rotation; std_msgs.msg Empty uint8 structure_needs_at_least_one_member
geometry_msgs.msg TransformStamped Header header, str child_frame_id, Transform transform
tf2_msgs.msg TFMessage TransformStamped[] transforms; geometry_msgs.msg Pose Point position, Quaternion orientation
geometry_msgs.msg PoseWithCovariance Pose pose, float64[36] covariance
geometry_msgs.msg PoseWithCovarianceStamped Header header, PoseWithCovariance pose
diagnostic_msgs.msg KeyValue str key, str value
diagnostic_msgs.msg DiagnosticStatus uint8 level, str name, str message, str hardware_id, KeyValue[] values
diagnostic_msgs.msg DiagnosticArray Header header, DiagnosticStatus[] status
sensor_msgs.msg Image Header header, uint32 height, uint32 width, str encoding, uint8 is_bigendian, uint32 step, uint8[] data
sensor_msgs.msg RegionOfInterest uint32 x_offset, uint32 y_offset, uint32 height, uint32 width, bool do_rectify
sensor_msgs.msg CameraInfo Header header, uint32 height, uint32 width, str distortion_model, float64[] d, float64[9] k, \
float64[9] r, float64[12] p, uint32 binning_x, uint32 binning_y, RegionOfInterest roi
std_srvs.srv Trigger_Request uint64 guid, int64 seq, uint8 structure_needs_at_least_one_member
std_srvs.srv Trigger_Response uint64 guid, int64 seq, bool success, str message"""
ROS: dict[str, Any] = {"str": str, "bool": bool}


def _of(text: str) -> Any:
    name, bracket, size = text.rstrip("]").partition("[")
    of = ROS.get(name) or getattr(idl.types, name)
    return of if not bracket else idl.types.array[of, int(size)] if size else idl.types.sequence[of]


for line in DEFINITIONS.replace("; ", "\n").splitlines():
    package, name, fields = line.split(" ", 2)
    known = {field: _of(of) for of, field in (part.split() for part in fields.split(", "))}
    ROS[name] = idl.make_idl_struct(f"{name}_", f"{package}.dds_.{name}_", known)


class Peer:
    """A program of a ROS user in the domain."""

    def __init__(self) -> None:
        encoding = core.Policy.DataRepresentation(use_cdrv0_representation=True)
        self.qos = core.Qos(core.Policy.Reliability.Reliable(10**9), core.Policy.History.KeepLast(100), encoding)
        self.own = domain.DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))

    def reads(self, name: str, kind: str) -> Any:
        return sub.DataReader(self.own, topic.Topic(self.own, name, ROS[kind]), qos=self.qos)

    async def writes(self, name: str, kind: str) -> Any:
        """Return a writer that has found its reader, as `ros2 topic pub -w 1` does."""
        writer = pub.DataWriter(self.own, topic.Topic(self.own, name, ROS[kind]), qos=self.qos)
        await until(writer.get_matched_subscriptions)
        return writer


@pytest.fixture(autouse=True)
def network(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + free_port() % 100))
    # An installed ROS finds others by multicast alone.
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK if find_spec("rclpy") is None else LOOPBACK[LOOPBACK.index("<Compat") :])


INSTALLED = pytest.param("rclpy", marks=pytest.mark.skipif(find_spec("tf2_msgs") is None, reason="no ROS 2 is installed"))


@pytest.mark.parametrize("middleware", ["dds", INSTALLED])
async def test_a_ros_program_sees_the_flight_and_its_orders_are_obeyed_or_refused(middleware, tmp_path, monkeypatch):
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    peer = Peer()
    tf, poses = peer.reads("rt/tf", "TFMessage"), peer.reads("rt/decklander/dead_reckoning/pad_pose", "PoseWithCovarianceStamped")
    health, replies = peer.reads("rt/diagnostics", "DiagnosticArray"), peer.reads("rr/decklander/abortReply", "Trigger_Response")
    async with serve_live() as service, asyncio.TaskGroup() as group:
        pilot = service.flight.pilot
        with patch.object(SystemClock, "now", lambda self: service.flight.world.now):
            terminals = OperatorSocket(socket_path(load("sim")), pilot, SystemClock())
            tasks = [group.create_task(terminals.run()), group.create_task(service.fly(1e6))]
            words = [sys.executable, "-m", "companion.cli.main", "ros2", service.address, "--config", "sim", "--orders"]
            words += ["--middleware", middleware]
            bridge = await asyncio.create_subprocess_exec(*words, stderr=subprocess.PIPE)
            await until(lambda: tf.read(1) and poses.read(1) and health.read(1))
            assert {t.child_frame_id for of in tf.take(100) for t in of.transforms} <= {"base_link", "base_stabilized"}
            assert -12.0 < poses.take(1)[0].pose.pose.position.z < -0.5, "the pad is below"
            begin, hold = [await peer.writes(f"rt/decklander/{order}", "Empty") for order in ("begin", "hold")]
            begin.write(ROS["Empty"](0), time.time_ns() - 60 * 10**9)
            for _ in range(40):
                hold.write(ROS["Empty"](0))
                await asyncio.sleep(0.01)
            assert pilot.outcome is None
            if middleware == "dds":
                abort = await peer.writes("rq/decklander/abortRequest", "Trigger_Request")
                for number, refusal, answer in ((7, None, (True, "accepted")), (8, "not now", (False, "refused: not now"))):
                    with patch.object(pilot.operator, "_refused", lambda *_, why=refusal: why):
                        abort.write(ROS["Trigger_Request"](65261, number, 0))
                        await until(lambda: replies.read(1))
                    got = replies.take(1)[0]
                    assert (got.guid, got.seq, got.success, got.message) == (65261, number, *answer)
            else:
                (await peer.writes("rt/decklander/abort", "Empty")).write(ROS["Empty"](0))
            await until(lambda: pilot.outcome is FlightOutcome.ABORTED)
            bridge.terminate()
            printed = (await bridge.communicate())[1].decode()
            for task in tasks:
                task.cancel()
    assert re.search(r"hold: accepted\n(.|\n)*refused orders: \d+ flood, 1 late", printed), printed
    assert "begin:" not in printed, "a late begin is not passed on"


async def test_an_image_topic_is_a_camera_with_its_own_times() -> None:
    peer = Peer()
    px, clock = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8), SystemClock()
    shown = {"bgr8": px, "rgb8": np.ascontiguousarray(px[:, :, ::-1]), "mono8": np.ascontiguousarray(px[:, :, 0])}
    options = CameraOptions(source="ros2", device="/camera/image_raw", silence_s=20.0)
    async with open_camera(options, (64, 48), clock, (100.0, 100.0, 31.5, 23.5)) as camera:
        images = await peer.writes("rt/camera/image_raw", "Image")

        def show(form: str, of: Any, at_ns: int, step: int = 0) -> None:
            head = ROS["Header"](ROS["Time"](*divmod(at_ns, 10**9)), "c")
            images.write(ROS["Image"](head, len(of), 64, form, 0, step or of.size // len(of), list(of.tobytes())))

        async with asyncio.timeout(60):
            while not camera.counters.frames:  # the reader drops what comes before it has found the writer
                show("bgr8", px, time.time_ns())
                await asyncio.sleep(0.3)
            await camera.frames.get()
        for form, of in shown.items():
            show(form, of, at_ns := time.time_ns() - 30_000_000)
            frame = await asyncio.wait_for(camera.frames.get(), 60)
            assert np.array_equal(frame.px, np.repeat(px[:, :, :1], 3, axis=2) if form == "mono8" else px)
            assert frame.stamp.measured_at + time.time_ns() - clock.now() == pytest.approx(at_ns, abs=5_000_000)
        for n, wrong in enumerate((("bgr8", px, 0, 7), ("32FC1", px, 0), ("bgr8", px[:-1], 0))):
            show(*wrong)
            await until(lambda n=n: camera.counters.frames_damaged == n + 1)
        infos, head = await peer.writes("rt/camera/camera_info", "CameraInfo"), ROS["Header"](ROS["Time"](0, 0), "c")
        K, region = [180, 0, 31.5, 0, 180, 23.5, 0, 0, 1], ROS["RegionOfInterest"](0, 0, 0, 0, False)
        info = ROS["CameraInfo"](head, 48, 64, "plumb_bob", [], K, [0] * 9, [0] * 12, 0, 0, region)
        await until(lambda: infos.write(info) or camera.down)
        assert camera.down.startswith("/camera/camera_info is of another camera than camera.file: 64x48 px, fx, fy, cx, cy = 180")


def test_messages_are_the_bytes_of_the_dds_library_and_what_cannot_be_used_is_one_line(monkeypatch, capsys) -> None:
    store, at = ros2.typestore(), ROS["Header"](ROS["Time"](5, 7), "deck")
    pose = ROS["Pose"](ROS["Point"](1, 2, 3), ROS["Quaternion"](0, 0, 0.6, 0.8))
    whole = ROS["PoseWithCovarianceStamped"](at, ROS["PoseWithCovariance"](pose, [0.5] * 36)).serialize(use_version_2=False)
    ours = store.deserialize_cdr(whole, kind := "geometry_msgs/msg/PoseWithCovarianceStamped")
    assert (ours.header.stamp.nanosec, ours.pose.pose.position.y, bytes(store.serialize_cdr(ours, kind))) == (7, 2.0, whole)
    with patch.object(ros2, "import_module", lambda name: import_module(f"{name}.not_there")):
        assert main(["ros2"]) == 2
    monkeypatch.setenv("ROS_DOMAIN_ID", "999")
    assert main(["ros2"]) == main(["ros2", "--namespace", "/a b"]) == 2
    printed = capsys.readouterr().err
    assert "there is no ROS 2 for this Python: No module named" in printed
    assert "ROS_DOMAIN_ID must be a number from 0 to 232, found '999'" in printed
