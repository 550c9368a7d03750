"""Result of a calibration flight: values, standard deviations, costs, and the reasons against its use.

The readout time of a rolling shutter comes from frames that are registered again, each as it would look at one instant for two
readout times. How the pad's orientation turns between the two is what a readout time does to it, and with that the readout is one
more unknown of the mount's fit: the gyro says how the vehicle turned, and only with the true readout do the poses turn alike.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from companion.recording.reading import RecordedFrame, Recording
from companion.tools.calibrate import touchdown_cost
from companion.tools.calibrate.flight_views import TILT_SIGMA_MAX_RAD, VIEWS_LEAST, FlightViews
from companion.tools.calibrate.mount_fit import DELAY, GYRO, LEVEL, MOUNT, READOUT, MountFit, exp, fit_mount, interpolated, logs
from companion.tools.calibrate.touchdown_cost import TouchdownCost
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Frame
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.register.registration import RegistrationOptions, register
from estimator.vision.rolling import CameraMotion, at_one_instant

FRAMES_MOST = 240
_FIRST_S, _CLOSE_S = (0.0, 0.02), 0.004
"""The two readout times of the first round, and how far those of the second lie to either side of its result."""
READOUT_LARGEST_S = 0.09
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


PAD_S, LEAN_DEG, TURN_DEG = 40.0, 4.0, 90.0
"""Needs of a calibration flight: time with the pad in view, tilts to each side, turns to each side."""
_GAP_S = 0.5


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


MOUNT_SIGMA_MAX_DEG = 0.3
DELAY_SIGMA_MAX_S = 0.003
READOUT_SIGMA_MAX_S = 0.003
"""Standard deviations above which a result is not written."""
DECK_TURNS_RAD = math.radians(0.2)
"""A pad that turns by more than this by itself is on a ship."""
_CONTRADICTING_MOST = 0.2
_DELAY_MOST_S = 0.25


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
        return touchdown_cost.of_mount(self.fit.values[MOUNT]), touchdown_cost.of_mount_sigma(cov)

    def delay_costs(self) -> tuple[TouchdownCost, TouchdownCost]:
        """Return what the old delay costs, and one standard deviation of the new one."""
        return touchdown_cost.of_delay(self.later_s), touchdown_cost.of_delay(self.delay_sigma_s)

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
        return touchdown_cost.of_readout(self.readout_s - self.was_s), touchdown_cost.of_readout(self.sigma_s)

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
