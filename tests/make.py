"""Instants, samples, estimates and frames for tests: one function each, and defaults that stand for any good value.

An instant `at` is given in seconds of the monotonic clock, or as a `Stamp`.

- instants: `ns`, `stamp` (seconds), `stamp_at` (nanoseconds)
- samples: `imu`, `attitude`, `velocity`, `range_down`, `baro`, `vessel`, `status`, `gimbal`
- vision: `sighting`, `frame`, `processed_frame`, `seen`
- estimates and what guidance knows: `estimate`, `deck`, `body`, `vessel_position`
- settings: `change`, which replaces keys by section, and `tuned`, which changes constants too
- two values that must be equal to the bit: `same_bits`
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeVar, cast

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from companion.base.observer import ProcessedFrame
from companion.guidance.mission.progress import VesselPosition
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Method, PathName, Pose6, RelativeState, Sighting, Verdict
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import (
    UNKNOWN_VAR,
    Attitude,
    Baro,
    BodyVelocity,
    Frame,
    GimbalAttitude,
    GimbalFrame,
    Imu,
    Range,
    VehicleStatus,
    VesselReport,
)
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp, StampSource
from estimator.core.library import CORE
from estimator.vision.detection import Detection, PadCheck, PadThing

Vector = Sequence[float] | F64
_T = TypeVar("_T", bound=msgspec.Struct)


def ns(seconds: float) -> MonoNs:
    """Return an instant given in seconds."""
    return MonoNs(round(seconds * NS_PER_S))


def stamp(t_s: float, delay_s: float = 0.0, *, sigma_s: float = 0.001, source: StampSource = "sim") -> Stamp:
    """Return the stamp of a sample that was measured at `t_s` and received `delay_s` later."""
    return Stamp(ns(t_s), ns(t_s + delay_s), sigma_s, source)


def stamp_at(measured_at: int, received_at: int | None = None, *, sigma_s: float = 0.001, source: StampSource = "sim") -> Stamp:
    """Return a stamp by its instants, ns; without `received_at` the sample has no delay."""
    return Stamp(MonoNs(measured_at), MonoNs(measured_at if received_at is None else received_at), sigma_s, source)


def _stamp(at: float | Stamp) -> Stamp:
    return at if isinstance(at, Stamp) else stamp(at)


def _cov(var: float | Vector, n: int) -> F64:
    """Return a diagonal covariance (n, n) from one variance or n of them."""
    return np.diag(np.broadcast_to(np.asarray(var, dtype=float), n))


def imu(at: float | Stamp, w: Vector = (0.0, 0.0, 0.0), f: Vector = (0.0, 0.0, -9.80665)) -> Imu:
    """Return turn rates (rad/s) and specific force (m/s^2) in `body`, by default of a level body at rest."""
    return Imu(_stamp(at), np.array(w, dtype=float), np.array(f, dtype=float))


def attitude(
    at: float | Stamp, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0, *, var: float | Vector = 1e-4
) -> Attitude:
    """Return the vehicle's own attitude, rad, with the variance about each body axis, rad^2."""
    return Attitude(_stamp(at), Rotation.from_rpy(roll, pitch, yaw), _cov(var, 3))


def velocity(at: float | Stamp, v: Vector = (0.0, 0.0, 0.0), *, var: float | Vector = (0.01, 0.01, UNKNOWN_VAR)) -> BodyVelocity:
    """Return a velocity in `level`, m/s, by default one whose vertical part was not measured."""
    return BodyVelocity(_stamp(at), np.array(v, dtype=float), _cov(var, 3))


def range_down(at: float | Stamp, range_m: float, sigma_m: float = 0.02) -> Range:
    """Return the reading of a range sensor that looks down."""
    return Range(_stamp(at), range_m, sigma_m)


def baro(at: float | Stamp, height_m: float = 1.0, sigma_m: float = 0.5) -> Baro:
    """Return a barometric height."""
    return Baro(_stamp(at), height_m, sigma_m)


def vessel(
    at: float | Stamp,
    v: Vector | None = None,
    heading_rad: float | None = None,
    *,
    var: float | Vector = 0.01,
    sigma_rad: float = 0.05,
    turn_rad_s: float | None = None,
) -> VesselReport:
    """Return a ship's report of its velocity over ground (ned, m/s), heading and rate of turn; None where it does not know."""
    return VesselReport(
        _stamp(at),
        None if v is None else np.array(v, dtype=float),
        None if v is None else _cov(var, 3),
        heading_rad,
        None if heading_rad is None else sigma_rad,
        turn_rad_s,
        None if turn_rad_s is None else 0.005,
    )


def status(at: float | Stamp, flying: bool | None = True, mode: str | None = None, **more: Any) -> VehicleStatus:
    """Return a vehicle's status: linked, with 80 % of its battery, in no emergency; `more` names what differs."""
    usual: dict[str, Any] = {"battery_fraction": 0.8, "emergency": False, "link_ok": True}
    return VehicleStatus(_stamp(at), flying, mode or ("flying" if flying else "landed"), **(usual | more))


def gimbal(at: float | Stamp, R: Rotation, frame: GimbalFrame = "level", *, var: float | Vector = 1e-6) -> GimbalAttitude:
    """Return a gimbal's attitude against `frame`."""
    return GimbalAttitude(_stamp(at), frame, R, _cov(var, 3))


def sighting(
    at: float | Stamp,
    d: Vector = (0.0, 0.0, 2.0),
    yaw: float | None = 0.0,
    *,
    var: float | Vector = 1e-4,
    yaw_var: float = 1e-3,
    method: Method = "selected",
    seq: int = 1,
    confidence: float = 0.9,
    ambiguous: bool = False,
    pose6: Pose6 | None = None,
) -> Sighting:
    """Return a sighting of the pad at `d` in `level`, m, with the heading `yaw` against its arrow, rad, or None."""
    cov = np.diag([*np.broadcast_to(np.asarray(var, dtype=float), 3), UNKNOWN_YAW_VAR if yaw is None else yaw_var])
    return Sighting(_stamp(at), seq, method, np.array(d, dtype=float), yaw, ambiguous, cov, confidence, pose6)


def frame(at: float | Stamp, seq: int = 0, px: NDArray[np.uint8] | None = None) -> Frame:
    """Return a frame, by default a black one of 6 x 4 pixels."""
    return Frame(_stamp(at), seq, np.zeros((4, 6, 3), np.uint8) if px is None else px)


def processed_frame(
    of: Frame, detection: Detection | Sighting | None = None, *, verdict: Verdict | None = None, own: Attitude | None = None
) -> ProcessedFrame:
    """Return a frame that took 5 ms from its reception, with what was detected in it."""
    if isinstance(detection, Sighting):
        detection = Detection(detection, detection.method, MappingProxyType({detection.method: detection}))
    began = of.stamp.received_at
    verdict = verdict or (Verdict.NO_PAD if detection is None else Verdict.FUSED)
    return ProcessedFrame(of, own, detection, verdict, began, MonoNs(began + 5_000_000))


def seen(at: MonoNs, found: bool) -> ProcessedFrame:
    """Return a frame exposed 30 ms before it was received at `at`, in which the pad was found or not."""
    exposed = Stamp(MonoNs(at - 30_000_000), at, 0.001, "sim")
    cov = np.diag([0.1, 0.2, 0.3, 0.4])
    one = Sighting(exposed, 7, "selected", np.array([1.0, 2.0, 3.0]), 0.5, True, cov, 0.9) if found else None
    check = PadCheck(at, 1.0, PadThing(0.25, 0.1, -0.15)) if found else None
    look = Detection(one, "ellipse" if found else None, MappingProxyType({"ellipse": one, "arrow": None}), on_pad=check)
    return processed_frame(frame(exposed, 7), look, verdict=Verdict.FUSED if found else Verdict.NO_PAD)


def estimate(
    t: float,
    d: ArrayLike = (0.0, 0.0, 2.0),
    v: ArrayLike = (0.0, 0.0, 0.0),
    yaw: float | None = 0.0,
    *,
    age: float = 0.0,
    sigma: float = 0.01,
    consistent: bool = True,
    path: PathName = "ekf",
    track: int = 1,
    **more: Any,
) -> RelativeState:
    """Return an estimate for the instant `t`, s, whose newest sighting is `age` old, s; `sigma` is that of every quantity."""
    cov = sigma**2 * np.eye(7)
    d, v = np.array(d, dtype=float), np.array(v, dtype=float)
    return RelativeState(ns(t), path, d, v, yaw, cov, ns(t - age), consistent, track=track, **more)


def deck(
    t: float,
    v: Vector = (0.0, 0.0, 0.0),
    a: Vector = (0.0, 0.0, 0.0),
    *,
    roll: float = 0.0,
    pitch: float = 0.0,
    var: float | Vector = 0.01,
) -> DeckMotion:
    """Return the deck's motion in `level`: velocity, m/s, acceleration, m/s^2, and tilt, rad; `var` is that of the motion."""
    v, a = np.array(v, dtype=float), np.array(a, dtype=float)
    return DeckMotion(ns(t), v, a, _cov(var, 6), roll, pitch, 0.0, 0.0, 1e-4 * np.eye(4))


def body(
    t: float, a: Vector = (0.0, 0.0, 0.0), w: Vector = (0.0, 0.0, 0.0), reported: Rotation | None = None, *, heading: float = 0.0
) -> BodyMotion:
    """Return the body's motion: acceleration in `level`, m/s^2, turn rates in `body`, rad/s, and the attitude that it reports."""
    a, w, cov = np.array(a, dtype=float), np.array(w, dtype=float), 1e-4 * np.eye(3)
    return BodyMotion(ns(t), heading, a, cov, w, reported or Rotation.identity(), cov)


def vessel_position(
    t: float,
    d: ArrayLike = (30.0, 4.0),
    *,
    sigma_m: float = 1.0,
    v: Vector = (2.0, 0.0),
    axis_rad: float = 0.0,
    bow: bool = True,
    height_m: float | None = 6.0,
) -> VesselPosition:
    """Return where the ship's own reports place the pad: aside and ahead in `level`, m."""
    d, v = np.array(d, dtype=float), np.array(v, dtype=float)
    return VesselPosition(ns(t), d, sigma_m, v, axis_rad, bow, height_m)


def change(options: _T, **sections: Any) -> _T:
    """Return options with other values of keys and constants; a mapping changes a section: `change(o, tries={"try_s": 9.0})`."""
    inner = {name: change(getattr(options, name), **of) if isinstance(of, Mapping) else of for name, of in sections.items()}
    if inner.keys() <= set(options.__struct_fields__):  # type: ignore[attr-defined]
        return msgspec.structs.replace(options, **inner)
    return tuned(type(options), **({name: getattr(options, name) for name in options.__struct_fields__} | inner))  # type: ignore[attr-defined]


def tuned(kind: type[_T], **values: Any) -> _T:
    """Return options of a kind, whose constants may have other values too."""
    constants = {name: value for name, value in values.items() if name not in kind.__struct_fields__}  # type: ignore[attr-defined]
    assert all(hasattr(kind, name) for name in constants)
    made = msgspec.defstruct(kind.__name__, [], bases=(kind,), namespace=constants, frozen=True)  # type: ignore[arg-type]
    return cast("_T", made(**{name: value for name, value in values.items() if name not in constants}))


def same_bits(a: Any, b: Any) -> bool:
    """Return whether two values are equal to the last bit of their arrays; structures and sequences are compared by members."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, Sequence) and isinstance(b, Sequence) and not isinstance(a, str | bytes):
        return len(a) == len(b) and all(map(same_bits, a, b))
    if type(a) is not type(b):
        return False
    if isinstance(a, Rotation):
        return same_bits(a.matrix, b.matrix)
    if isinstance(a, CORE.ffi.CData):
        return bytes(CORE.ffi.buffer(a)) == bytes(CORE.ffi.buffer(b))
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(same_bits(a[key], b[key]) for key in a)
    if names := getattr(a, "__struct_fields__", None) or getattr(a, "__dataclass_fields__", None):
        return all(same_bits(getattr(a, name), getattr(b, name)) for name in names)
    return bool(a == b or (a != a and b != b))
