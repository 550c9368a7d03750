"""One event of a recording as standard messages of ROS 2, in the frames and axes of REP-103.

A message's header has the instant of the measurement; the bag has the instant at which the service processed it. Both are on
the time axis of the recording. What was not measured is left out as the message's own definition says: a first element of -1
in a covariance of `sensor_msgs/Imu`, nan for a place's height, and the variance of an angle that could be anything in a pose.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from companion.base.observer import Decision
from companion.facts import records as rec
from companion.facts.encode import held_rotation
from companion.recording.frame_encoder import VideoImage
from companion.recording.message_encoder import packed
from companion.recording.reading import Event, RecordedFrame, instant
from estimator.contracts import samples
from estimator.contracts.commands import Hover, Lean, Velocity
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, RelativeState, Sighting
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.time import NS_PER_S, MonoNs
from estimator.vision.camera.camera import Camera

# The axes of ROS (REP-103): x forward, y left, z up on a body, and east, north, up on the Earth.
#
# Our `body` and `level` are forward-right-down, `ned` is north-east-down, `pad` has z into the deck. In each of the first two
# and in `pad`, half a turn about x leads to the axes of ROS, so one matrix converts them all. Our `cam` has the axes of an
# optical frame of ROS as it is.
#
# Frames (REP-105): `base_link` is the body, `base_stabilized` the same without roll and pitch, `deck` the pad with z up, `map`
# east-north-up; `camera_optical_frame` is the camera, and `range_down` has x along the range sensor's beam.

BODY, LEVEL, DECK, MAP = "base_link", "base_stabilized", "deck", "map"
CAMERA, BEAM = "camera_optical_frame", "range_down"

UP = np.diag([1.0, -1.0, -1.0])
"""Takes forward-right-down to forward-left-up, and back."""
ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
R_BODY_BEAM = Rotation.from_rpy(0.0, 0.5 * math.pi, 0.0)
"""The rotation from `range_down` to `base_link`: the beam's x axis points down."""
_SECONDS_MAX = 2**31 - 1  # largest time of a message, s
_INFO = 20  # level of rcl_interfaces/Log
_OK = 0  # level of diagnostic_msgs/DiagnosticStatus
_ERROR = 2  # level of diagnostic_msgs/DiagnosticStatus
_JPEG_QUALITY = 90  # quality of a picture, percent
_FIX = 0  # status of sensor_msgs/NavSatStatus
_GPS = 1  # service of sensor_msgs/NavSatStatus
_DIAGONAL_KNOWN = 2  # kind of sensor_msgs/NavSatFix's covariance
_CYLINDER = 3  # type of visualization_msgs/Marker
_LINE_LIST = 5  # type of visualization_msgs/Marker
_CONE_M = 5.0  # height of the cone that is drawn
_CONE_LINES = 16  # number of its lines


def enu_attitude(R_ned_body: Rotation) -> Rotation:
    """Return the rotation from `base_link` to `map` of an attitude."""
    return Rotation(ENU_NED @ R_ned_body.matrix @ UP)


def deck_heading(yaw_rad: float) -> Rotation:
    """Return the rotation from `base_stabilized` to `deck`, from the heading against the arrow, clockwise seen from above."""
    return Rotation.from_rpy(0.0, 0.0, -yaw_rad)


def pad_in_level(cov: F64) -> F64:
    """Return the covariance (6, 6) of the pad's pose in `base_stabilized`: x, y, z in m, then rotations about them in rad.

    The pad's tilt is not estimated; it has the variance of an angle that could be anything.

    Args:
        cov: the covariance (4, 4) of [forward, right, down, yaw] in m and rad, or (7, 7) with the velocity before the yaw.
    """
    keep = [0, 1, 2, -1]
    # The pad turns to the left in `base_stabilized` by as much as the body's heading turns to the right on the pad.
    signs = np.diag([1.0, -1.0, -1.0, 1.0])
    return _padded(signs @ cov[np.ix_(keep, keep)] @ signs)


def level_in_deck(d_body_pad_level: F64, yaw_rad: float, cov: F64) -> tuple[F64, F64]:
    """Return the place (3,) m of `base_stabilized` in `deck`, and the covariance (6, 6) of its pose.

    Args:
        d_body_pad_level: the vector (3,) m to the pad.
        yaw_rad: the heading against the arrow.
        cov: the covariance (7, 7) of [d, v, yaw].
    """
    R, d = deck_heading(yaw_rad).matrix, UP @ d_body_pad_level
    # The place is -R d, and R turns with the heading: d/d(heading) of R d is z x (R d).
    turned = np.cross([0.0, 0.0, 1.0], R @ d)
    J = np.zeros((4, 4))
    J[:3, :3] = -R @ UP
    J[:3, 3] = turned
    J[3, 3] = -1.0
    keep = [0, 1, 2, 6]
    return -(R @ d), _padded(J @ cov[np.ix_(keep, keep)] @ J.T)


def _padded(cov: F64) -> F64:
    """Return a covariance (6, 6) of a pose from that (4, 4) of place and heading."""
    out = np.zeros((6, 6))
    out[:3, :3], out[:3, 5], out[5, :3], out[5, 5] = cov[:3, :3], cov[:3, 3], cov[3, :3], cov[3, 3]
    out[3, 3] = out[4, 4] = UNKNOWN_YAW_VAR
    return out


KEPT = ("/tf_static",)
"""Topics whose newest message a late subscriber gets, too (transient local)."""
Message = tuple[str, str, int, Any]
"""Topic, type, time in the bag in ns, and the message."""
_Topic = tuple[str, Any]
"""Topic and message."""
_NOT_GIVEN = np.array([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


class RosMessages:
    """Turns events into messages; it remembers the phase last sent and where the newest estimate has the pad.

    Args:
        store: the definitions and classes of messages, `typestore()`.
        offset_ns: the offset from the events' instants to the time axis, ns.
        camera: the recording's camera; None leaves out what needs one.
        gimballed: whether a gimbal turns the camera, so that its transform comes with each frame.
        drawn: the pad's radius in m and the radius of the cone of the way down over its height, for `/markers`.
    """

    def __init__(
        self, store: Any, offset_ns: int, camera: Camera | None, *, gimballed: bool = False, drawn: tuple[float, ...] = ()
    ) -> None:
        self._store = store
        self._gimballed, self._drawn = gimballed, drawn
        self._offset_ns = offset_ns
        self._camera = camera
        self._phase, self._fixed_sent = "", False

    def _fixed(self, at: MonoNs) -> _Topic:
        """Return the transforms that never change: the camera's mount and the range sensor's beam."""
        stamped = [self._transform(at, BODY, BEAM, np.zeros(3), R_BODY_BEAM)]
        if self._camera is not None and not self._gimballed:
            stamped.append(self._transform(at, BODY, CAMERA, *_mount(self._camera, self._camera.T_body_cam.R)))
        return "/tf_static", self._make("tf2_msgs/msg/TFMessage", transforms=stamped)

    def _markers(self, at: MonoNs, radius_m: float, slope: float) -> _Topic:
        """Return the pad's disc and the cone of the way down in `deck`; `slope` is the cone's radius over its height."""
        turns = np.linspace(0.0, 2.0 * math.pi, _CONE_LINES, endpoint=False)
        rim = np.stack([slope * _CONE_M * np.cos(turns), slope * _CONE_M * np.sin(turns), np.full(_CONE_LINES, _CONE_M)], axis=1)
        lines = [end for i in range(_CONE_LINES) for end in (np.zeros(3), rim[i], rim[i - 1], rim[i])]
        both = [
            self._stamped(
                "visualization_msgs/Marker", at, DECK, ns="decklander", id=form, type=form, scale=np.array(scale),
                color={"r": r, "g": 0.7, "b": 0.0, "a": 0.7}, lifetime=3 * NS_PER_S, frame_locked=True, points=points,
            )
            for form, scale, r, points in (
                (_CYLINDER, [2.0 * radius_m, 2.0 * radius_m, 0.01], 0.1, []), (_LINE_LIST, [0.02, 0.0, 0.0], 1.0, lines),
            )
        ]  # fmt: skip
        return "/markers", self._make("visualization_msgs/msg/MarkerArray", markers=both)

    def of(self, event: Event) -> Iterator[Message]:
        """Yield the messages of an event; none of one that ROS has no standard message for."""
        at = self._time(instant(event))
        fixed, self._fixed_sent = () if self._fixed_sent else (self._fixed(instant(event)),), True
        for topic, message in (*fixed, *self._messages(event)):
            yield topic, message.__msgtype__, at, message

    def _messages(self, event: Event) -> Iterator[_Topic]:
        match event:
            case RecordedFrame():
                yield from self._frame(event)
            case Decision():
                yield from self._decision(event)
            case rec.TruthRecord():
                d, v = np.array(event.d_body_pad_level), np.array(event.v_pad_level)
                yield "/truth/odometry", self._odometry(MonoNs(event.at_ns), d, v, event.yaw_rad, np.zeros((7, 7)))
            case rec.HealthRecord():
                yield "/diagnostics", self._diagnostics(event)
                if self._drawn:
                    yield self._markers(instant(event), *self._drawn)
            case rec.FusionRecord() | rec.LinkRecord() | rec.OrderRecord():
                return
            case _:
                yield from self._sample(event)

    def _make(self, kind: str, /, **fields: Any) -> Any:
        """Return a message; what is not given is zero, empty or the identity."""
        given = {name: self._value(int(node), what, fields.get(name)) for name, (node, what) in self._store.fielddefs[kind][1]}
        return self._store.types[kind](**given)

    def _value(self, node: int, what: Any, given: Any) -> Any:
        """Return a field's value: of a message a stamp's nanoseconds, a vector, a rotation or a dict; of an array a matrix.

        Args:
            node: the kind of field in rosbags: 1 plain, 2 a message, 3 an array, 4 a sequence.
            what: its type.
        """
        match node, given:
            case 1, None:
                return "" if what[0] == "string" else 0
            case 2, int():
                sec, nanosec = divmod(given, NS_PER_S)
                return self._make(what, sec=sec, nanosec=nanosec)
            case 2, Rotation():
                return self._make(what, **dict(zip("wxyz", given.quat_wxyz.tolist(), strict=True)))
            case 2, np.ndarray():
                return self._make(what, **dict(zip("xyz", given.tolist(), strict=True)))
            case 2, None | dict():
                return self._make(what, **(given or ({"w": 1.0} if what.endswith("Quaternion") else {})))
            case 3, _:
                return np.zeros(what[1]) if given is None else np.ascontiguousarray(given, np.float64).ravel()
            case 4, None:
                return np.zeros(0, what[0][1][0]) if int(what[0][0]) == 1 else []
            case 4, list():
                return [self._value(int(what[0][0]), what[0][1], one) for one in given]
        return given

    def _time(self, at: MonoNs) -> int:
        """Return an instant on the time axis, ns, as far as a stamp of ROS reaches."""
        return min(max(0, int(at) + self._offset_ns), _SECONDS_MAX * NS_PER_S)

    def _stamped(self, kind: str, at: MonoNs, frame: str, **fields: Any) -> Any:
        return self._make(kind.replace("/", "/msg/"), header={"stamp": self._time(at), "frame_id": frame}, **fields)

    def _transform(self, at: MonoNs, parent: str, child: str, place: F64, R: Rotation) -> Any:
        transform = {"translation": place, "rotation": R}
        return self._stamped("geometry_msgs/TransformStamped", at, parent, child_frame_id=child, transform=transform)

    def _moving(self, at: MonoNs, parent: str, child: str, place: F64, R: Rotation) -> _Topic:
        return "/tf", self._make("tf2_msgs/msg/TFMessage", transforms=[self._transform(at, parent, child, place, R)])

    def _sample(self, of: object) -> Iterator[_Topic]:
        match of:
            case samples.Imu():
                yield "/imu/data_raw", self._imu(of)
            case samples.Attitude():
                yield "/imu/data", self._attitude(of)
                yield self._moving(
                    of.stamp.measured_at, LEVEL, BODY, np.zeros(3), Rotation(UP @ of.R_ned_body.without_heading().matrix @ UP)
                )
            case samples.BodyVelocity():
                twist = _twist_with_cov(UP @ of.v_level, UP @ of.cov_level @ UP)
                yield (
                    "/velocity",
                    self._stamped("geometry_msgs/TwistWithCovarianceStamped", of.stamp.measured_at, LEVEL, twist=twist),
                )
            case samples.Range():
                known = {"max_range": math.inf, "range": of.range_m, "variance": of.sigma_m**2}
                yield "/range", self._stamped("sensor_msgs/Range", of.stamp.measured_at, BEAM, **known)
            case samples.Baro():
                yield "/baro/height", self._make("std_msgs/msg/Float64", data=of.height_m)
            case samples.GeoFix():
                yield f"/{of.whose}/fix", self._fix(of)
            case samples.VesselReport():
                yield from self._vessel(of)
            case samples.VesselMotion():
                yield from self._motion(of)
            case samples.VesselWind():
                toward = -of.speed_m_s * np.array([math.sin(of.from_rad), math.cos(of.from_rad), 0.0])
                yield "/vessel/wind", self._stamped("geometry_msgs/Vector3Stamped", of.stamp.measured_at, MAP, vector=toward)
            case samples.VehicleStatus():
                yield "/battery", self._battery(of)
                yield "/mode", self._make("std_msgs/msg/String", data=of.mode)

    def _imu(self, of: samples.Imu) -> Any:
        """Return rates and specific force in `base_link`: at rest and level it reads +9.81 on z."""
        rates, force = UP @ of.w_body, UP @ of.f_body
        return self._stamped(
            "sensor_msgs/Imu", of.stamp.measured_at, BODY, orientation_covariance=_NOT_GIVEN, angular_velocity=rates,
            linear_acceleration=force,
        )  # fmt: skip

    def _attitude(self, of: samples.Attitude) -> Any:
        """Return the orientation of `base_link` in `map`; its covariance is about the axes of `base_link`."""
        return self._stamped(
            "sensor_msgs/Imu", of.stamp.measured_at, BODY, orientation=enu_attitude(of.R_ned_body),
            orientation_covariance=UP @ of.cov_body @ UP, angular_velocity_covariance=_NOT_GIVEN,
            linear_acceleration_covariance=_NOT_GIVEN,
        )  # fmt: skip

    def _fix(self, of: samples.GeoFix) -> Any:
        """Return a place without its height: ours is above mean sea level, that of the message above the ellipsoid."""
        place, variance = of.place, of.sigma_m**2
        return self._stamped(
            "sensor_msgs/NavSatFix", of.stamp.measured_at, BODY if of.whose == "vehicle" else "vessel",
            status={"status": _FIX, "service": _GPS}, latitude=math.degrees(place.latitude_rad),
            longitude=math.degrees(place.longitude_rad), altitude=math.nan,
            position_covariance=np.diag([variance, variance, 1e6]), position_covariance_type=_DIAGONAL_KNOWN,
        )  # fmt: skip

    def _vessel(self, of: samples.VesselReport) -> Iterator[_Topic]:
        at = of.stamp.measured_at
        if of.v_vessel_ned is not None and of.cov_v_ned is not None:
            twist = _twist_with_cov(ENU_NED @ of.v_vessel_ned, ENU_NED @ of.cov_v_ned @ ENU_NED.T)
            yield "/vessel/velocity", self._stamped("geometry_msgs/TwistWithCovarianceStamped", at, MAP, twist=twist)
        if of.heading_rad is not None:
            R = enu_attitude(Rotation.from_rpy(0.0, 0.0, of.heading_rad))
            yield "/vessel/heading", self._stamped("geometry_msgs/QuaternionStamped", at, MAP, quaternion=R)
        if of.turn_rad_s is not None:
            turn = np.array([0.0, 0.0, -of.turn_rad_s])
            yield "/vessel/turn", self._stamped("geometry_msgs/Vector3Stamped", at, MAP, vector=turn)

    def _motion(self, of: samples.VesselMotion) -> Iterator[_Topic]:
        """Yield roll and pitch, and heave as a height, each in a frame with the sensor's name."""
        at = of.stamp.measured_at
        if of.roll_rad is not None and of.pitch_rad is not None:
            R = Rotation(UP @ Rotation.from_rpy(of.roll_rad, of.pitch_rad, 0.0).matrix @ UP)
            yield "/vessel/tilt", self._stamped("geometry_msgs/QuaternionStamped", at, of.sensor, quaternion=R)
        if of.heave_down_m is not None:
            height = np.array([0.0, 0.0, -of.heave_down_m])
            yield "/vessel/heave", self._stamped("geometry_msgs/Vector3Stamped", at, of.sensor, vector=height)

    def _battery(self, of: samples.VehicleStatus) -> Any:
        unknown = dict.fromkeys(("voltage", "temperature", "current", "charge", "capacity", "design_capacity"), math.nan)
        charge = math.nan if of.battery_fraction is None else of.battery_fraction
        return self._stamped("sensor_msgs/BatteryState", of.stamp.measured_at, BODY, percentage=charge, present=True, **unknown)

    def _frame(self, frame: RecordedFrame) -> Iterator[_Topic]:
        exposed = frame.stamp.measured_at
        R_body_cam = held_rotation(frame.record)
        if R_body_cam is not None and self._camera is not None:
            yield self._moving(exposed, BODY, CAMERA, *_mount(self._camera, R_body_cam))
        image = _image(frame)
        if image is not None:
            form, data = image
            packed_as = {"format": f"bgr8; {form} compressed bgr8", "data": np.frombuffer(data, np.uint8)}
            yield "/camera/image_raw/compressed", self._stamped("sensor_msgs/CompressedImage", exposed, CAMERA, **packed_as)
            if self._camera is not None:
                yield "/camera/camera_info", self._camera_info(exposed, self._camera)
        detection = frame.detection()
        if detection is not None and detection.selected is not None:
            yield "/detection/pad_pose", self._pad_pose(exposed, detection.selected)

    def _camera_info(self, at: MonoNs, camera: Camera) -> Any:
        K = camera.K
        return self._stamped(
            "sensor_msgs/CameraInfo", at, CAMERA, height=camera.height, width=camera.width,
            distortion_model="plumb_bob" if camera.lens == "brown" else "equidistant",
            d=np.array(camera.distortion), k=K, r=np.eye(3), p=np.hstack([K, np.zeros((3, 1))]),
        )  # fmt: skip

    def _pad_pose(self, measured_at: MonoNs, of: Sighting | RelativeState) -> Any:
        """Return the pad's pose in `base_stabilized`; an unknown heading has the variance of anything."""
        R = deck_heading(of.yaw_rad or 0.0).inv
        pose = _pose(UP @ of.d_body_pad_level, R, pad_in_level(of.cov))
        return self._stamped("geometry_msgs/PoseWithCovarianceStamped", measured_at, LEVEL, pose=pose)

    def _odometry(self, at: MonoNs, d: F64, v_pad: F64, yaw_rad: float, cov: F64) -> Any:
        """Return the pose of `base_stabilized` in `deck`, and its velocity against the deck in its own axes."""
        place, cov_pose = level_in_deck(d, yaw_rad, cov)
        return self._stamped(
            "nav_msgs/Odometry", at, DECK, child_frame_id=LEVEL, pose=_pose(place, deck_heading(yaw_rad), cov_pose),
            twist=_twist_with_cov(-UP @ v_pad, UP @ cov[3:6, 3:6] @ UP),
        )  # fmt: skip

    def _decision(self, of: Decision) -> Iterator[_Topic]:
        for belief in (b for b in (of.belief, *of.shadows) if b is not None):
            yield f"/{belief.path}/pad_pose", self._pad_pose(of.at, belief)
            if belief.yaw_rad is not None:
                d, v = belief.d_body_pad_level, belief.v_pad_level
                yield f"/{belief.path}/odometry", self._odometry(of.at, d, v, belief.yaw_rad, belief.cov)
        if of.belief is not None and of.belief.yaw_rad is not None:
            place, _ = level_in_deck(of.belief.d_body_pad_level, of.belief.yaw_rad, of.belief.cov)
            yield self._moving(of.at, DECK, LEVEL, place, deck_heading(of.belief.yaw_rad))
        yield from self._command(of)
        for change in of.transitions:
            text = f"{change.source.value}: {change.event.value}, {change.reason.text}: {change.target.value}"
            stamp = self._time(change.at)
            yield "/rosout", self._make("rcl_interfaces/msg/Log", stamp=stamp, level=_INFO, name="guidance", msg=text)
        if of.phase != self._phase:
            self._phase = of.phase
            yield "/phase", self._make("std_msgs/msg/String", data=of.phase)

    def _command(self, of: Decision) -> Iterator[_Topic]:
        match of.command:
            case Velocity(v_level=v, yaw_rate_rad_s=rate) | Lean(v_level=v, yaw_rate_rad_s=rate):
                twist = _twist(UP @ v, -rate)
            case Hover():
                twist = _twist(np.zeros(3))
            case _:
                return
        yield "/cmd_vel", self._stamped("geometry_msgs/TwistStamped", of.at, LEVEL, twist=twist)
        if isinstance(of.command, Lean):
            forward, right = of.command.a_level.tolist()
            accel = {"linear": np.array([forward, -right, 0.0])}
            yield "/cmd_accel", self._stamped("geometry_msgs/AccelStamped", of.at, LEVEL, accel=accel)

    def _diagnostics(self, of: rec.HealthRecord) -> Any:
        statuses = [
            {
                "level": _OK if part.up else _ERROR, "name": part.name, "message": "up" if part.up else part.last_error or "down",
                "values": [{"key": "restarts", "value": str(part.restarts)}],
            }
            for part in of.parts
        ]  # fmt: skip
        return self._stamped("diagnostic_msgs/DiagnosticArray", MonoNs(of.at_ns), "", status=statuses)


def _pose(place: F64, R: Rotation, cov: F64) -> dict[str, Any]:
    return {"pose": {"position": place, "orientation": R}, "covariance": cov}


def _twist(v: F64, yaw_rate_rad_s: float = 0.0) -> dict[str, Any]:
    return {"linear": v, "angular": np.array([0.0, 0.0, yaw_rate_rad_s])}


def _twist_with_cov(v: F64, cov: F64) -> dict[str, Any]:
    """Return a twist with an unknown turn: the variances are very large."""
    whole = np.diag([0.0, 0.0, 0.0, 1e6, 1e6, 1e6])
    whole[:3, :3] = cov
    return {"twist": {"linear": v}, "covariance": whole}


def _mount(camera: Camera, R_body_cam: Rotation) -> tuple[F64, Rotation]:
    """Return the place and the rotation of `camera_optical_frame` in `base_link`."""
    return UP @ camera.T_body_cam.t, Rotation(UP @ R_body_cam.matrix)


def _image(frame: RecordedFrame) -> tuple[str, bytes] | None:
    """Return form and bytes of a frame's image; one of a video is encoded again as JPEG, and a damaged one is left out."""
    if frame.image is None:
        return None
    if isinstance(frame.image, VideoImage):
        px = frame.image.px()
        return None if px is None else ("jpeg", packed(px, "jpeg", _JPEG_QUALITY))
    return ("png" if frame.image.startswith(b"\x89PNG") else "jpeg"), frame.image
