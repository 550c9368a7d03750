"""Result of a calibration flight: values, standard deviations, costs, and the reasons against its use.

The readout time of a rolling shutter comes from frames that are registered again, each as it would look at one instant for two
readout times. How the pad's orientation turns between the two is what a readout time does to it, and with that the readout is one
more unknown of the mount's fit: the gyro says how the vehicle turned, and only with the true readout do the poses turn alike.

An error's cost is the distance beside the pad's centre at touchdown. A camera that is turned by an angle sees the pad beside its
place by the angle times the distance. Lower than `LAST_SIGHTING_M` the pad fills the frame, and the filter carries on by the IMU.
A delay shows the pad where it was, beside its place by a speed times the delay, and by the angle that the vehicle has turned
meanwhile, times the distance. The law that follows the deck reacts late as well, so the speed is not that across the pad but what
simulated landings show. A readout time that is wrong is a delay that differs from row to row. A focal length that is wrong by a
share makes every distance wrong by it; a pad that stays in the middle of the frame does not move aside by that, one beside it by
the vehicle's tilt does.

Of the vehicle's response: near the deck, at sea state 4, gusts, the deck and the filter's errors drive the loop of
`companion.guidance.law.margins`. Its law is made for the response of a file. With another vehicle than the file's it errs by
more, and the squares' difference is the cost.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from msgspec import structs

from companion.guidance.law.margins import axis_error_m
from companion.recording.reading import RecordedFrame, Recording
from companion.settings.guidance import TiltResponse
from companion.tools.calibrate.flight_views import TILT_SIGMA_MAX_RAD, VIEWS_LEAST, FlightViews
from companion.tools.calibrate.mount_fit import DELAY, GYRO, LEVEL, MOUNT, READOUT, MountFit, exp, fit_mount, interpolated, logs
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Frame
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.camera.rolling import CameraMotion, at_one_instant
from estimator.vision.pad.pad import Pad
from estimator.vision.register.registration import RegistrationOptions, register

LAST_SIGHTING_M = 0.4
"""Distance of the last sighting: lower the pad fills the frame."""
DELAY_SPEED_M_S = 0.9
"""Cost of a second of delay: 50 ms added 4.7 cm rms to ten landings of the scenario demo."""
TURN_RATE_RAD_S = 0.25
"""Rate of roll and pitch while the vehicle follows a deck."""
APPROACH_M = 3.0
"""Height at which guidance begins to descend, where an error costs most."""
LEAN_RAD = math.radians(8.5)
"""Lean of a small vehicle near the deck, against a wind of 2.5 m/s and the way of a ship at 1.5 m/s."""
FRAMES_MOST = 240
"""Frames that are registered again."""
_FIRST_S = (0.0, 0.02)
"""The two readout times of the first round."""
_CLOSE_S = 0.004  # how far those of the second lie to either side of its result
READOUT_LARGEST_S = 0.09
"""Longest readout time that is searched."""
PAD_S = 40.0
"""Time with the pad in view that a calibration flight needs."""
LEAN_DEG = 4.0
"""Tilts to each side that it needs."""
TURN_DEG = 90.0
"""Turns to each side that it needs."""
_GAP_S = 0.5  # longest gap between two views that counts as the pad in view
MOUNT_SIGMA_MAX_DEG = 0.3
"""Standard deviation of the mount above which a result is not written."""
DELAY_SIGMA_MAX_S = 0.003
"""Standard deviation of the delay above which it is not."""
READOUT_SIGMA_MAX_S = 0.003
"""Standard deviation of the readout time above which it is not."""
DECK_TURNS_RAD = math.radians(0.2)
"""A pad that turns by more than this by itself is on a ship."""
_CONTRADICTING_MOST = 0.2  # share of the views that may contradict the result
_DELAY_MOST_S = 0.25  # longest delay beyond that of the file


class TouchdownCost(NamedTuple):
    """Centimetres at touchdown, and at the beginning of the descent."""

    touchdown_cm: float
    approach_cm: float


def of_mount(rotvec_rad: F64) -> TouchdownCost:
    """Return the cost of a camera turned by a rotation vector in `body`; a turn about the vertical does not shift the pad."""
    angle = float(np.hypot(rotvec_rad[0], rotvec_rad[1]))
    return TouchdownCost(100.0 * angle * LAST_SIGHTING_M, 100.0 * angle * APPROACH_M)


def of_mount_sigma(cov: F64) -> TouchdownCost:
    """Return the cost of a mount that is known with this covariance, (3, 3) rad^2: one standard deviation."""
    return of_mount(np.array([math.sqrt(cov[0, 0]), math.sqrt(cov[1, 1]), 0.0]))


def of_distance(share: float) -> tuple[TouchdownCost, TouchdownCost]:
    """Return what distances that are wrong by a share cost: of the height, and aside by the tilt of a vehicle in wind."""
    height = TouchdownCost(100.0 * share * LAST_SIGHTING_M, 100.0 * share * APPROACH_M)
    return height, TouchdownCost(*(math.tan(LEAN_RAD) * cm for cm in height))


def of_delay(seconds: float) -> TouchdownCost:
    """Return the cost of a delay that is wrong by this much."""
    late = abs(seconds)
    touchdown, approach = (
        math.hypot(DELAY_SPEED_M_S, TURN_RATE_RAD_S * distance_m) * late for distance_m in (LAST_SIGHTING_M, APPROACH_M)
    )
    return TouchdownCost(100.0 * touchdown, 100.0 * approach)


def of_readout(seconds: float) -> TouchdownCost:
    """Return the cost of a readout time that is wrong by this much, for a pad a quarter of the frame off the middle row."""
    return of_delay(0.25 * seconds)


_TILT_RANGES = ((0.0, 0.6), (1.0, 60.0), (0.2, 3.0))
"""Delay, frequency and damping that a response may have."""


class ResponseCost(NamedTuple):
    """Root mean square distance from the pad's centre at touchdown, both axes."""

    error_cm: float
    """Error by the file's response; inf if the loop is unstable."""
    own_cm: float
    """Error by the vehicle's own response."""

    @property
    def cost_cm(self) -> float:
        """Further drift by the response's error, in squares; 0 if it does no harm."""
        return math.sqrt(max(0.0, self.error_cm**2 - self.own_cm**2))


def tilt_of_file(file: TiltResponse, vehicle: TiltResponse) -> ResponseCost:
    """Return the cost of a file's response for a vehicle."""
    return ResponseCost(*(100.0 * math.sqrt(2.0) * axis_error_m(assumed, vehicle) for assumed in (file, vehicle)))


def tilt_of_sigma(found: TiltResponse, cov: F64) -> ResponseCost:
    """Return the cost of a response for the worst vehicle that is one standard deviation from it.

    Args:
        found: the response that the law is made for.
        cov: covariance of its delay, frequency and damping, (3, 3), in s, rad/s and 1.
    """
    sizes, axes = np.linalg.eigh(cov)
    steps = (axes * np.sqrt(np.maximum(sizes, 0.0))).T
    costs = [[tilt_of_file(found, _tilt_moved(found, sign * step)) for sign in (1.0, -1.0)] for step in steps]
    tried = [cost for pair in costs for cost in pair]
    slopes = np.array([plus.error_cm**2 - plus.own_cm**2 - minus.error_cm**2 + minus.own_cm**2 for plus, minus in costs])
    if np.isfinite(slopes).all() and np.linalg.norm(slopes) > 0.0:
        # Of a cost that changes evenly the worst lies there.
        tried.append(tilt_of_file(found, _tilt_moved(found, slopes / np.linalg.norm(slopes) @ steps)))
    return max(tried, key=lambda cost: cost.cost_cm)


def _tilt_moved(of: TiltResponse, by: F64) -> TiltResponse:
    values = np.array([of.delay_s, of.frequency_rad_s, of.damping]) + by
    delay, frequency, damping = (float(np.clip(v, *within)) for v, within in zip(values, _TILT_RANGES, strict=True))
    return structs.replace(of, delay_s=delay, frequency_rad_s=frequency, damping=damping)


_OPTIONS = RegistrationOptions(coarse=True)


def _fit_readout(recording: Recording, views: FlightViews) -> tuple[MountFit, float]:
    """Return the fit with mount and delay, and the readout time, s.

    Raises:
        BadInput: the recording does not hold its pad, or too few frames with their images.
    """
    pad = recording.pad()
    if pad is None:
        raise BadInput(f"{recording.name}: does not hold its pad; record the flight with decklander")
    first = fit_mount(views)
    frames = _frames(recording, views)
    motions = _motions(views, first)
    found, of, around = first, views, _FIRST_S
    for _ in range(2):
        of = _registered(recording.name, views, frames, motions, pad, around)
        found = fit_mount(of)
        # The derivative is that of the readout found, and not of 0.
        middle = min(READOUT_LARGEST_S, max(-READOUT_LARGEST_S, float(of.readout_s + found.values[READOUT])))
        around = middle - _CLOSE_S, middle + _CLOSE_S
    return found, float(of.readout_s + found.values[READOUT])


def _frames(recording: Recording, views: FlightViews) -> dict[int, Frame]:
    """Return the views' frames, by the number of the view."""
    wanted = {stamp: i for i, stamp in enumerate(views.stamps_ns)}
    every = -(-len(wanted) // FRAMES_MOST)
    size = views.camera.width, views.camera.height
    out: dict[int, Frame] = {}
    for event in recording.events():
        if isinstance(event, RecordedFrame) and (i := wanted.get(int(event.stamp.measured_at))) is not None:
            frame = event.frame(size) if i % every == 0 else None
            if frame is not None:
                out[i] = frame
    if len(out) < VIEWS_LEAST:
        raise BadInput(
            f"{recording.name}: holds the images of {len(out)} views of the pad, and {VIEWS_LEAST} are needed; record the flight "
            'with its frames as "jpeg", "png" or "h264"'
        )
    return out


def _motions(views: FlightViews, fit: MountFit) -> list[CameraMotion]:
    """Return the camera's motion in each view; nan where the pad's rate is not known."""
    assert views.speed_cam is not None
    R_body_cam = exp(fit.values[MOUNT]) @ views.camera.T_body_cam.R.matrix
    t = views.t + fit.values[DELAY]
    w_body = np.stack([np.interp(t, views.t_gyro, axis) for axis in views.w_body.T], axis=1) - fit.values[GYRO]
    w_cam = w_body @ R_body_cam
    # The rate of the pad's place in the turning axes has the rotation in it.
    v_cam = views.speed_cam + np.cross(w_cam, views.t_cam_pad)
    return [CameraMotion(w, v) for w, v in zip(w_cam, v_cam, strict=True)]


def _registered(
    name: str, views: FlightViews, frames: dict[int, Frame], motions: list[CameraMotion], pad: Pad, around: tuple[float, float]
) -> FlightViews:
    """Return the views registered as of the first of two readout times, with what the second one changes."""
    kept, turns, places, covs, by = [], [], [], [], []
    cameras = [replace(views.camera, readout_s=s) for s in around]
    for i, frame in frames.items():
        if not np.isfinite(motions[i].v_pad_cam).all():
            continue
        about = PadPose(Rotation(views.R_cam_pad[i]), views.t_cam_pad[i])
        both = [one for one in _poses(frame, cameras, pad, about, motions[i]) if one is not None]
        if len(both) == 2:
            (pose, cov), (other, _) = both
            kept.append(i)
            turns.append(pose.R_cam_pad.matrix)
            places.append(pose.t_cam_pad)
            covs.append(cov)
            by.append(other.R_cam_pad.matrix @ pose.R_cam_pad.matrix.T)
    if len(kept) < VIEWS_LEAST:
        raise BadInput(f"{name}: the pad was registered again in {len(kept)} frames, and {VIEWS_LEAST} are needed")
    apart_s = around[1] - around[0]
    return replace(
        views, t=views.t[kept], R_cam_pad=np.array(turns), t_cam_pad=np.array(places), cov=np.array(covs),
        stamps_ns=tuple(views.stamps_ns[i] for i in kept), speed_cam=None, readout_s=around[0],
        by_readout=logs(np.array(by)) / apart_s,
    )  # fmt: skip


def _poses(
    frame: Frame, cameras: list[Camera], pad: Pad, about: PadPose, motion: CameraMotion
) -> Iterator[tuple[PadPose, F64] | None]:
    for camera in cameras:
        found = register(at_one_instant(frame.px, camera, about, motion), camera, pad, about, options=_OPTIONS)
        sure = found is not None and float(np.diag(found.cov)[3:].max()) < TILT_SIGMA_MAX_RAD**2
        yield (found.pose, found.cov[3:, 3:]) if found is not None and sure and not found.yaw_ambiguous else None


@dataclass(slots=True)
class FlightCoverage:
    """Counts what counts while the pad is in view."""

    pad_s: float = 0.0
    roll_deg: tuple[float, float] = (0.0, 0.0)
    """Farthest to the left (negative) and to the right."""
    pitch_deg: tuple[float, float] = (0.0, 0.0)
    """Farthest nose down (negative) and nose up."""
    clockwise_deg: float = 0.0
    """Turned clockwise, in all."""
    counter_deg: float = 0.0
    height_m: tuple[float, float] | None = None
    """Lowest and highest."""
    _last: tuple[float, float] | None = None

    def add(self, t: float, roll_rad: float, pitch_rad: float, heading_rad: float, height_m: float | None) -> None:
        """Take note of the attitude at an instant, s, at which the pad is in view."""
        roll, pitch = math.degrees(roll_rad), math.degrees(pitch_rad)
        self.roll_deg = min(self.roll_deg[0], roll), max(self.roll_deg[1], roll)
        self.pitch_deg = min(self.pitch_deg[0], pitch), max(self.pitch_deg[1], pitch)
        if height_m is not None:
            low, high = self.height_m or (height_m, height_m)
            self.height_m = min(low, height_m), max(high, height_m)
        if self._last is not None and 0.0 < t - self._last[0] <= _GAP_S:
            turned = math.degrees(wrap_pi(heading_rad - self._last[1]))
            self.pad_s += t - self._last[0]
            self.clockwise_deg += max(0.0, turned)
            self.counter_deg += max(0.0, -turned)
        self._last = t, heading_rad

    def missing(self) -> list[str]:
        """Return what the flight should still show, most important first."""
        out = []
        if self.pad_s < PAD_S:
            out.append(f"the pad in view for {PAD_S:.0f} s ({self.pad_s:.0f} s so far)")
        leans = (
            ("left", -self.roll_deg[0]),
            ("right", self.roll_deg[1]),
            ("forward", -self.pitch_deg[0]),
            ("back", self.pitch_deg[1]),
        )
        out += [f"lean {way} by {LEAN_DEG:.0f} degrees or more ({far:.0f} so far)" for way, far in leans if far < LEAN_DEG]
        turns = (("clockwise", self.clockwise_deg), ("counter-clockwise", self.counter_deg))
        out += [
            f"turn about the vertical {way} by {TURN_DEG:.0f} degrees or more ({far:.0f} so far)"
            for way, far in turns
            if far < TURN_DEG
        ]
        return out

    def in_words(self) -> str:
        """Return one line."""
        low, high = self.height_m or (math.nan, math.nan)
        heights = "" if self.height_m is None else f", {low:.1f} to {high:.1f} m"
        return (
            f"pad {self.pad_s:.0f} s{heights}; leans left {-self.roll_deg[0]:.0f}, right {self.roll_deg[1]:.0f}, forward "
            f"{-self.pitch_deg[0]:.0f}, back {self.pitch_deg[1]:.0f} degrees; turns clockwise {self.clockwise_deg:.0f}, "
            f"counter-clockwise {self.counter_deg:.0f} degrees"
        )


@dataclass(frozen=True, slots=True, eq=False)
class MountResult:
    """Mount and delay from one flight."""

    fit: MountFit
    coverage: FlightCoverage
    rpy_was_deg: F64
    rpy_deg: F64
    """Angles of the camera file, (3,), as they were and as they should be."""

    @property
    def turned_deg(self) -> F64:
        """Rotation of the camera from its file, (3,), about the body's axes."""
        return np.degrees(self.fit.values[MOUNT])

    @property
    def cov_mount_deg2(self) -> F64:
        return np.asarray(np.degrees(np.degrees(self.fit.cov[MOUNT, MOUNT])))

    @property
    def mount_sigma_deg(self) -> F64:
        return np.degrees(self.fit.sigma[MOUNT])

    @property
    def later_s(self) -> float:
        """Further delay of the frames behind their stamps."""
        return float(self.fit.values[DELAY])

    @property
    def delay_sigma_s(self) -> float:
        return float(self.fit.sigma[DELAY])

    @property
    def level_deg(self) -> tuple[F64, F64]:
        """Constant error of the reported roll and pitch, (2,), and its standard deviation."""
        return np.degrees(self.fit.values[LEVEL]), np.degrees(self.fit.sigma[LEVEL])

    def mount_costs(self) -> tuple[TouchdownCost, TouchdownCost]:
        """Return what the old file costs, and one standard deviation of the new one."""
        cov = self.fit.cov[MOUNT, MOUNT]
        return of_mount(self.fit.values[MOUNT]), of_mount_sigma(cov)

    def delay_costs(self) -> tuple[TouchdownCost, TouchdownCost]:
        """Return what the old delay costs, and one standard deviation of the new one."""
        return of_delay(self.later_s), of_delay(self.delay_sigma_s)

    def mount_refusal(self) -> str | None:
        """Return why the mount is not known well enough, or None."""
        worst = float(self.mount_sigma_deg.max())
        if worst > MOUNT_SIGMA_MAX_DEG:
            return f"the mount is known to {worst:.2f} degrees only, and {MOUNT_SIGMA_MAX_DEG:g} are needed"
        return self.contradiction()

    def delay_refusal(self) -> str | None:
        """Return why the delay is not known well enough, or None."""
        if self.delay_sigma_s > DELAY_SIGMA_MAX_S:
            return f"the delay is known to {1e3 * self.delay_sigma_s:.1f} ms only, and {1e3 * DELAY_SIGMA_MAX_S:.0f} are needed"
        if abs(self.later_s) > _DELAY_MOST_S:
            return f"the stamps are off by {1e3 * abs(self.later_s):.0f} ms or more, beyond what is searched"
        return self.contradiction()

    def contradiction(self) -> str | None:
        """Return why the views contradict each other, or None."""
        share = self.fit.left_out / self.fit.views
        if share > _CONTRADICTING_MOST:
            return f"{100 * share:.0f} % of the views contradict the rest: the pad's size, the lens or the gyro is wrong"
        return None

    def advice(self) -> list[str]:
        """Return what would make it better, most important first."""
        out = self.coverage.missing()
        if self.fit.noise.deck_rad > DECK_TURNS_RAD:
            turned_deg = math.degrees(self.fit.noise.deck_rad)
            out.append(f"a pad that stands still: this one turned by {turned_deg:.1f} degrees; fly ashore")
        return out


@dataclass(frozen=True, slots=True, eq=False)
class ReadoutResult:
    """The readout time from one flight."""

    readout_s: float
    sigma_s: float
    was_s: float
    """The readout time of the camera file in the recording."""
    mount: MountResult
    """Mount and delay as they were found along with it."""

    def costs(self) -> tuple[TouchdownCost, TouchdownCost]:
        """Return what the old readout time costs, and one standard deviation of the new one."""
        return of_readout(self.readout_s - self.was_s), of_readout(self.sigma_s)

    def refusal(self) -> str | None:
        """Return why the readout time is not known well enough, or None."""
        if self.sigma_s > READOUT_SIGMA_MAX_S:
            return f"the readout is known to {1e3 * self.sigma_s:.1f} ms only, and {1e3 * READOUT_SIGMA_MAX_S:.0f} are needed"
        if abs(self.readout_s) > READOUT_LARGEST_S:
            return f"the readout would take {1e3 * self.readout_s:.0f} ms, beyond what is searched"
        return self.mount.contradiction()


def readout_result(recording: Recording, views: FlightViews) -> ReadoutResult:
    """Fit the readout time, mount and delay along with it, and say what the flight has shown.

    Raises:
        BadInput: the recording does not hold its pad or its images.
    """
    fit, readout_s = _fit_readout(recording, views)
    return ReadoutResult(readout_s, float(fit.sigma[READOUT]), views.camera.readout_s, _of_fit(fit, views))


def flight_result(views: FlightViews) -> MountResult:
    """Fit mount and delay, and say what the flight has shown."""
    return _of_fit(fit_mount(views), views)


def _of_fit(fit: MountFit, views: FlightViews) -> MountResult:
    mount = views.camera.T_body_cam.R
    turned = Rotation(exp(fit.values[MOUNT]) @ mount.matrix)
    return MountResult(fit, coverage_of(views), np.degrees(mount.rpy_rad), np.degrees(_near(turned, mount)))


def coverage_of(views: FlightViews) -> FlightCoverage:
    """Return what the views of a flight cover."""
    coverage = FlightCoverage()
    attitudes = interpolated(views.t_attitude, views.R_ned_body, views.t)
    for t, R, distance in zip(views.t, attitudes, np.linalg.norm(views.t_cam_pad, axis=1), strict=True):
        coverage.add(float(t), *Rotation(R).rpy_rad, float(distance))
    return coverage


def _near(turned: Rotation, mount: Rotation) -> tuple[float, float, float]:
    """Return roll, pitch and yaw, each by less than half a turn from those of the mount before."""
    angles = (before + wrap_pi(now - before) for now, before in zip(turned.rpy_rad, mount.rpy_rad, strict=True))
    roll, pitch, yaw = angles
    return roll, pitch, yaw
