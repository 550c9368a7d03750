"""What a calibration flight found, judged: values, standard deviations, costs, and why it may not be used."""

import math
from dataclasses import dataclass

import numpy as np

from companion.recording.reading import Recording
from companion.tools.calibrate import touchdown_cost
from companion.tools.calibrate.flight_views import FlightViews
from companion.tools.calibrate.mount_fit import DELAY, LEVEL, MOUNT, MountFit, fit_mount
from companion.tools.calibrate.readout_fit import READOUT_LARGEST_S, ReadoutFit, fit_readout
from companion.tools.calibrate.rotations import exp, interpolated
from companion.tools.calibrate.touchdown_cost import TouchdownCost
from estimator.contracts.geometry import F64, Rotation, wrap_pi

PAD_S, LEAN_DEG, TURN_DEG = 40.0, 4.0, 90.0
"""What a flight should have: time with the pad in view, leans to each side, turns to each side."""
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
        """How the camera is turned from its file, (3,), about the body's axes."""
        return np.degrees(self.fit.values[MOUNT])

    @property
    def cov_mount_deg2(self) -> F64:
        return np.asarray(np.degrees(np.degrees(self.fit.cov[MOUNT, MOUNT])))

    @property
    def mount_sigma_deg(self) -> F64:
        return np.degrees(self.fit.sigma[MOUNT])

    @property
    def later_s(self) -> float:
        """By how much the frames show the world later than their stamps say."""
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

    fit: ReadoutFit
    mount: MountResult
    """Mount and delay as they were found along with it."""

    @property
    def readout_s(self) -> float:
        return self.fit.readout_s

    @property
    def sigma_s(self) -> float:
        return self.fit.sigma_s

    def costs(self) -> tuple[TouchdownCost, TouchdownCost]:
        """Return what the old readout time costs, and one standard deviation of the new one."""
        return touchdown_cost.of_readout(self.readout_s - self.fit.was_s), touchdown_cost.of_readout(self.sigma_s)

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
    fit = fit_readout(recording, views)
    return ReadoutResult(fit, _of_fit(fit.fit, views))


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
