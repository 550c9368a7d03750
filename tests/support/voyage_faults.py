"""Single sensor faults in the middle of a simulated voyage, and the filter's flight through them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import Rotation, wrap_pi
from estimator.contracts.samples import Attitude, BodyVelocity, Imu, Range
from estimator.contracts.time import MonoNs
from tests.support.voyage_score import Score, fly_voyage
from tests.support.voyage_truth import Event, VoyageScene

BEGIN_S = 12.0
SCENE = VoyageScene(sea="jonswap", duration_s=22.0, gaps=0, imu_hz=100.0)
AHEAD = np.array([1.0, 0.0, 0.0])
HOUR_NS = 3_600_000_000_000


@dataclass(frozen=True)
class VoyageFault:
    """Something that happens to a stream for some seconds."""

    spoil: Callable[[Event], Sequence[Event]]
    lasts_s: float = 0.005


def _imu(w: float = 0.0, f: float = 0.0) -> Callable[[Event], Sequence[Event]]:
    by_w, by_f = np.array([w, 0.0, 0.0]), np.array([0.0, f, 0.0])
    return lambda e: [replace(e, w_body=e.w_body + by_w, f_body=e.f_body + by_f)] if isinstance(e, Imu) else [e]


def _turned(e: Event) -> Sequence[Event]:
    return [replace(e, R_ned_body=e.R_ned_body @ Rotation.from_rpy(0.7, 0.0, 0.7))] if isinstance(e, Attitude) else [e]


def _opposite(e: Event) -> Sequence[Event]:
    if not isinstance(e, Sighting) or e.yaw_rad is None:
        return [e]
    return [replace(e, yaw_rad=wrap_pi(e.yaw_rad + math.pi))]


def _ahead(e: Event) -> Sequence[Event]:
    later = replace(e.stamp, measured_at=MonoNs(e.stamp.measured_at + HOUR_NS), received_at=MonoNs(e.stamp.received_at + HOUR_NS))
    return [replace(e, stamp=later)]


def frozen() -> Callable[[Event], Sequence[Event]]:
    """Return the same inertial sample again and again, with new stamps."""
    first: list[Imu] = []

    def spoil(e: Event) -> Sequence[Event]:
        if not isinstance(e, Imu):
            return [e]
        first.append(e)
        return [replace(e, w_body=first[0].w_body, f_body=first[0].f_body)]

    return spoil


FAULTS: dict[str, Callable[[], VoyageFault]] = {
    "nothing": lambda: VoyageFault(lambda e: [e], 0.0),
    "accelerometer 1e4": lambda: VoyageFault(_imu(f=1e4), 0.015),
    "accelerometer 500": lambda: VoyageFault(_imu(f=500.0), 0.015),
    "accelerometer 45": lambda: VoyageFault(_imu(f=45.0), 0.015),
    "accelerometer 75": lambda: VoyageFault(_imu(f=75.0), 0.015),
    "gyro 300": lambda: VoyageFault(_imu(w=300.0), 0.015),
    "gyro 12": lambda: VoyageFault(_imu(w=12.0), 0.015),
    "gyro 34": lambda: VoyageFault(_imu(w=34.0), 0.015),
    "attitude 40 degrees": lambda: VoyageFault(_turned, 0.3),
    "velocity 30 m/s": lambda: VoyageFault(
        lambda e: [replace(e, v_level=e.v_level + 30.0 * AHEAD)] if isinstance(e, BodyVelocity) else [e], 0.4
    ),
    "range 0": lambda: VoyageFault(lambda e: [replace(e, range_m=0.0)] if isinstance(e, Range) else [e], 0.5),
    "sightings 2 m aside": lambda: VoyageFault(
        lambda e: [replace(e, d_body_pad_level=e.d_body_pad_level + 2.0 * AHEAD)] if isinstance(e, Sighting) else [e], 0.4
    ),
    "heading turned round": lambda: VoyageFault(_opposite, 2.0),
    "an hour ahead": lambda: VoyageFault(_ahead, 0.005),
    "no inertial data": lambda: VoyageFault(lambda e: [] if isinstance(e, Imu) else [e], 4.9),
    "inertial data frozen": lambda: VoyageFault(frozen(), 4.9),
}
"""Each fault by its name."""


def suffered(name: str, scene: VoyageScene = SCENE) -> tuple[Score, float]:
    """Return the flight with a fault, scored from 11 s on, and when the fault ends, s."""
    fault = FAULTS[name]()
    end = BEGIN_S + fault.lasts_s

    def spoil(e: Event, t: float) -> Sequence[Event]:
        return fault.spoil(e) if BEGIN_S <= t < end else [e]

    return fly_voyage(scene, since_s=11.0, spoil=spoil, forecasts=False), end
