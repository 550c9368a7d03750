"""Every alert of the guard is raised by its fault, and ends by itself: after its stream ended, or became good again."""

import math
from collections.abc import Set as AbstractSet

import numpy as np
import pytest

from estimator.contracts.estimates import IntegrityAlert, Pose6, RelativeState, Sighting
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Baro, Frame, Imu, Range, Sample
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity import IntegrityGuard, admit, admit_frame, admit_sighting, alerts, judged

HZ, LATE_S = 30, 0.1
PAD = np.array([0.1, 0.0, 2.0])
MIRROR = np.diag([-1.0, 1.0, 1.0])
ENDS_S = 1.2
"""An alert ends a second after the newest evidence, which is as old as a frame is late."""
STREAMS = {
    IntegrityAlert.CAMERA_FROZEN: (Frame, 0.1), IntegrityAlert.VIEW_FROZEN: (Sighting, 1.0),
    IntegrityAlert.VIEW_REVERSED: (Sighting, 10.0), IntegrityAlert.IMU_LATE: (Sighting, 10.0),
    IntegrityAlert.IMU_FROZEN: (Imu, 0.1), IntegrityAlert.ATTITUDE_FROZEN: (Attitude, 0.1),
    IntegrityAlert.ATTITUDE: (Attitude, 5.0), IntegrityAlert.STAMPS: (Sighting, 0.1), IntegrityAlert.APART: (Sighting, 1.0),
    IntegrityAlert.ELSEWHERE: (Sighting, 1.2), IntegrityAlert.RANGE: (Range, 3.0), IntegrityAlert.HEIGHT: (Baro, 14.0),
}  # fmt: skip
"""The stream that each alert accuses, and the time within which it ends once that is good again, s."""


class Streams:
    """A vehicle that sways over the pad, two metres high, with all its streams and a fault in one of them."""

    def __init__(self) -> None:
        self.guard, self.n = IntegrityGuard(), 30 * HZ
        self._rng = np.random.default_rng(7)
        self._attitudes: list[Attitude] = []

    @property
    def now(self) -> MonoNs:
        return MonoNs(round(self.n * 1e9 / HZ))

    def raised(self) -> tuple[IntegrityAlert, ...]:
        return alerts(self.guard, self.now)

    def step(self, fault: IntegrityAlert | None = None, ended: AbstractSet[type] = frozenset()) -> None:
        """Go on for one frame; the streams of the types `ended` are silent."""
        self.n += 1
        for sub in (1, 2, 3):
            self._samples((self.n + sub / 3 - 1) / HZ, fault, ended)
        t = self.n / HZ
        pixels = np.zeros(48) if fault is IntegrityAlert.CAMERA_FROZEN else self._rng.uniform(0, 255, 48)
        if Frame not in ended:
            image = pixels.astype(np.uint8).reshape(16, 1, 3)
            self.guard, _ = admit_frame(self.guard, Frame(self._stamp(t), self.n, image))
        if Sighting not in ended and Attitude not in ended:
            self._see(t, fault)

    def _body(self, t: float) -> Rotation:
        return Rotation.from_rpy(0.12 * math.sin(4.0 * t), 0.1 * math.sin(3.1 * t + 1.0), 0.3)

    def _stamp(self, t: float, late_s: float = 0.0) -> Stamp:
        return Stamp(MonoNs(round((t - late_s) * 1e9)), MonoNs(round(t * 1e9)), 0.001, "sim")

    def _samples(self, t: float, fault: IntegrityAlert | None, ended: AbstractSet[type]) -> None:
        noise, now = self._rng.standard_normal, self._stamp(t)
        R, before = self._body(t), self._body(t - 0.01)
        w, f = (before.inv @ R).rotvec_rad / 0.01 + 0.01 * noise(3), R.inv @ np.array([0.0, 0.0, -9.81]) + 0.05 * noise(3)
        if fault is IntegrityAlert.IMU_FROZEN:
            w, f = np.zeros(3), np.array([0.0, 0.0, -9.81])
        reported = R @ Rotation.from_rotvec(0.002 * noise(3))
        if fault is IntegrityAlert.ATTITUDE_FROZEN:
            reported = self._body(0.0)
        if fault is IntegrityAlert.ATTITUDE:
            reported = Rotation.from_rpy(0.0, 0.0, 0.3) @ Rotation.from_rotvec(0.002 * noise(3))
        if fault is IntegrityAlert.IMU_LATE:
            reported = self._body(t - 0.1)
        baro_m = 30.0 + (0.9 * t if fault is IntegrityAlert.HEIGHT else 27.0)
        samples: list[Sample] = [
            Imu(now, w, f), Attitude(now, reported, 1e-4 * np.eye(3)), Baro(now, baro_m + 0.3 * float(noise()), 0.5),
            Range(now, (3.0 if fault is IntegrityAlert.RANGE else 2.02) + 0.005 * float(noise()), 0.02),
        ]  # fmt: skip
        samples = [each for each in samples if type(each) not in ended]
        self.guard, _ = admit(self.guard, samples)
        self._attitudes += [each for each in samples if isinstance(each, Attitude)]

    def _see(self, t: float, fault: IntegrityAlert | None) -> None:
        at = t - LATE_S
        attitude = min(self._attitudes[-20:], key=lambda each: abs(each.stamp.measured_at * 1e-9 - at))
        R, level = self._body(at).without_heading(), attitude.R_ned_body.without_heading()
        d_body = R.inv @ PAD
        if fault is IntegrityAlert.VIEW_FROZEN:
            d_body = PAD
        if fault is IntegrityAlert.VIEW_REVERSED:
            d_body = MIRROR @ d_body
        d = level @ d_body + 0.002 * self._rng.standard_normal(3)
        if fault is IntegrityAlert.ELSEWHERE:
            d = d + np.array([1.0, 0.0, 0.0])
        stamp = self._stamp(t, LATE_S + (0.3 if fault is IntegrityAlert.STAMPS else 0.0))
        pose = Pose6(d, level @ R.inv, 1e-4 * np.eye(6))
        seen = Sighting(stamp, self.n, "registration", d, -0.3, False, np.diag([1e-4, 1e-4, 1e-4, 1e-3]), 0.9, pose)
        believed = d + np.array([1.5, 0.0, 0.0]) if fault is IntegrityAlert.APART else PAD
        belief = RelativeState(
            stamp.measured_at, "ekf", believed, np.zeros(3), 0.0, 1e-4 * np.eye(7), stamp.measured_at, consistent=True
        )
        self.guard, verdict = admit_sighting(self.guard, seen, attitude, belief)
        if verdict is None:
            self.guard = judged(self.guard, seen, attitude, is_fused=True)


@pytest.mark.hazard("H4")
@pytest.mark.parametrize("ends", [True, False], ids=["silent", "good again"])
@pytest.mark.parametrize("alert", STREAMS)
def test_an_alert_ends_by_itself_after_its_stream_ended_or_became_good(alert: IntegrityAlert, ends: bool) -> None:
    """WHY: a range sensor that contradicted for a second and then died barred every landing of the flight."""
    stream, good_s = STREAMS[alert]
    flown, limit_s = Streams(), ENDS_S if ends else good_s
    for _ in range(3 * HZ if alert is not IntegrityAlert.HEIGHT else 8 * HZ):
        flown.step()
        assert flown.raised() == ()
    since = flown.n
    while alert not in flown.raised():
        flown.step(alert)
        assert flown.n < since + 20 * HZ, "it is raised"
    ended_at = flown.n
    while alert in flown.raised():
        flown.step(None, {stream} if ends else frozenset())
        assert flown.n <= ended_at + limit_s * HZ, "it ends by itself"


def test_every_alert_of_the_guard_is_tried() -> None:
    assert set(IntegrityAlert) - set(STREAMS) == {IntegrityAlert.UNFELT, IntegrityAlert.DECK}, "guidance raises these"
