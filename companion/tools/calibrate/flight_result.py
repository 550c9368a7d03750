"""Result of a calibration flight: values, standard deviations, costs, and the reasons against its use."""

import math
from dataclasses import dataclass

import numpy as np

from companion.recording.reading import Recording
from companion.tools.calibrate.coverage import FlightCoverage, coverage_of
from companion.tools.calibrate.flight_views import FlightViews
from companion.tools.calibrate.gyro_attitude import exp
from companion.tools.calibrate.mount_fit import DELAY, LEVEL, MOUNT, READOUT, MountFit, fit_mount
from companion.tools.calibrate.readout import READOUT_LARGEST_S, fit_readout
from companion.tools.calibrate.touchdown_cost import TouchdownCost, of_delay, of_mount, of_mount_sigma, of_readout
from estimator.contracts.geometry import F64, Rotation, wrap_pi

MOUNT_SIGMA_MAX_DEG = 0.3
"""Standard deviation of the mount above which a result is not written (docs/cameras.md)."""
DELAY_SIGMA_MAX_S = 0.003
"""Standard deviation of the delay above which it is not (docs/cameras.md)."""
READOUT_SIGMA_MAX_S = 0.003
"""Standard deviation of the readout time above which it is not."""
DECK_TURNS_RAD = math.radians(0.2)
"""A pad that turns by more than this by itself is on a ship."""
_CONTRADICTING_MOST = 0.2  # share of the views that may contradict the result
_DELAY_MOST_S = 0.25  # longest delay beyond that of the file


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
    fit, readout_s = fit_readout(recording, views)
    return ReadoutResult(readout_s, float(fit.sigma[READOUT]), views.camera.readout_s, _of_fit(fit, views))


def flight_result(views: FlightViews) -> MountResult:
    """Fit mount and delay, and say what the flight has shown."""
    return _of_fit(fit_mount(views), views)


def _of_fit(fit: MountFit, views: FlightViews) -> MountResult:
    mount = views.camera.T_body_cam.R
    turned = Rotation(exp(fit.values[MOUNT]) @ mount.matrix)
    return MountResult(fit, coverage_of(views), np.degrees(mount.rpy_rad), np.degrees(_near(turned, mount)))


def _near(turned: Rotation, mount: Rotation) -> tuple[float, float, float]:
    """Return roll, pitch and yaw, each by less than half a turn from those of the mount before."""
    angles = (before + wrap_pi(now - before) for now, before in zip(turned.rpy_rad, mount.rpy_rad, strict=True))
    roll, pitch, yaw = angles
    return roll, pitch, yaw
