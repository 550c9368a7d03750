"""The guard: each input meets its checks in turn, a refusal changes no later one, and each alert is raised and ends."""

import math
from collections.abc import Set as AbstractSet

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.contracts.estimates import IntegrityAlert, Pose6, RelativeState, Sighting, Verdict
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Baro, Frame, Imu, Range, Sample
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity.guard import IntegrityGuard, admit, admit_frame, admit_sighting, alerts, excludes, follow, judged
from estimator.integrity.options import IntegrityOptions
from tests import make
from tests.make import baro, imu, ns, stamp, status, tuned

T, HEADING = 100.0, 0.5
NOW = ns(T)


def attitude_of(t: float, roll: float = 0.0) -> Attitude:
    return make.attitude(t, roll, 0.0, HEADING)


def sighting(t: float, d: tuple[float, float, float] = (1.0, 0.5, 2.0), delay_s: float = 0.0) -> Sighting:
    return make.sighting(stamp(t - delay_s, delay_s), d, var=(4e-4, 12e-4, 9e-4))


def estimate(d: tuple[float, float, float], sigma_m: float) -> RelativeState:
    return RelativeState(NOW, "ekf", np.array(d), np.zeros(3), 0.0, sigma_m**2 * np.eye(7), NOW, True)


def admit_one(guard: IntegrityGuard, sample: Sample) -> tuple[IntegrityGuard, Verdict | None]:
    guard, (admitted,) = admit(guard, [sample])
    return guard, admitted if isinstance(admitted, Verdict) else None


def see(
    guard: IntegrityGuard, seen: Sighting, at: Attitude | None = None, by: RelativeState | None = None
) -> tuple[IntegrityGuard, Verdict | None]:
    """Return the guard after a sighting under an attitude, by an estimate, and the verdict."""
    return admit_sighting(guard, seen, at, by)


@pytest.mark.parametrize(("flying", "then"), [(True, True), (False, False), (None, True)])
def test_a_vehicle_flies_until_it_says_that_it_does_not_and_only_then_may_a_reading_repeat(flying, then):
    guard, verdict = admit_one(IntegrityGuard(flying=not then), status(T, flying, "flying"))
    assert (guard.flying, verdict) == (then, None)
    for i in range(4):
        guard, verdict = admit_one(guard, baro(T + i))
    assert verdict is (Verdict.FROZEN if then else None)


def test_arrival_delay_and_reading_are_judged_in_turn() -> None:
    guard, verdict = admit_one(IntegrityGuard(), imu(T))
    assert (verdict, set(guard.sensors)) == (None, {Imu})
    late, verdict = admit_one(guard, baro(T + 2))
    assert (verdict, Baro in late.sensors, late.clock.rival is not None) == (Verdict.TOO_NEW, False, True)
    for i in range(10):
        guard, verdict = admit_one(guard, baro(T + 1e-3 * i, float(i)))
        assert verdict is None
    delayed, verdict = admit_one(guard, baro(stamp(T - 0.99, 1.0)))
    assert (verdict, delayed.clock.off("Baro"), delayed.sensors) == (Verdict.TOO_OLD, True, guard.sensors)
    assert set(guard.sensors) == {Imu, Baro}
    assert admit_one(guard, imu(T + 0.01, f=(0.0, 0.0, -99.0)))[1] is Verdict.IMPOSSIBLE


def test_the_heading_that_a_gyro_held_goes_with_the_gyro_once_it_is_named() -> None:
    """WHY: the heading of a gyro that turned by itself for two seconds was held against a right compass for a minute more."""
    rng, guard, off_deg = np.random.default_rng(3), IntegrityGuard(), list[float]()
    for n in range(700):
        t = T + 0.01 * n
        w = rng.normal((0.0, 0.0, math.radians(15.0) * (n > 200)), 0.01)
        sample, (roll, pitch) = imu(t, w, rng.normal((0.0, 0.0, -9.8), 0.05)), 0.002 * rng.standard_normal(2)
        guard, (_, passed) = admit(guard, [sample, make.attitude(t, roll, pitch, HEADING)])
        off_deg.append(abs(math.degrees(passed.R_ned_body.rpy_rad[2] - HEADING)))
        if n % 3 == 0:
            guard, _ = see(guard, sighting(t), attitude_of(t))
            guard = judged(guard, sighting(t), attitude_of(t), is_fused=True)
        if guard.inertial.gyro_fault is not None:
            break
    assert "yaw" in guard.lost[0]
    assert off_deg[-1] < 0.01
    assert max(off_deg) > 6.0, "the gyro's heading until then"


def test_after_a_leap_of_the_time_every_delay_begins_again() -> None:
    guard, _ = admit(IntegrityGuard(), [imu(T), baro(T)])
    assert set(guard.clock.delays) == {"Imu", "Baro"}
    guard, (first, second) = admit(guard, [status(T + 100), baro(stamp(T + 99.95, 0.05), 2.0)])
    assert (first, isinstance(second, Baro), guard.clock.now) == (Verdict.TOO_NEW, True, ns(T + 100))
    assert {kind: delay.median_s for kind, delay in guard.clock.delays.items()} == {"Baro": pytest.approx(0.05)}


def test_a_frame_that_repeats_is_refused() -> None:
    frame = make.frame(T, px=np.zeros((32, 4, 3), np.uint8))
    guard, verdict = admit_frame(IntegrityGuard(), frame)
    assert (verdict, admit_frame(guard, frame)[1]) == (None, Verdict.REPEATED)


@pytest.mark.parametrize("known", [True, False])
def test_a_sighting_is_placed_in_axes_of_fixed_heading_with_its_own_uncertainty(known: bool) -> None:
    guard, verdict = see(IntegrityGuard(), sighting(T), attitude_of(T) if known else None)
    c, s = (math.cos(HEADING), math.sin(HEADING)) if known else (1.0, 0.0)
    assert verdict is None
    assert guard.tracks.last.d == pytest.approx((c - 0.5 * s, s + 0.5 * c, 2.0))
    assert (guard.tracks.last.sigma_m, guard.tracks.last.sigma_down_m) == pytest.approx((math.sqrt(8e-4), 0.03))


def followed() -> IntegrityGuard:
    """Return a guard that has seen the pad, which was fused nine times."""
    guard, _ = see(IntegrityGuard(), sighting(T), attitude_of(T))
    for _ in range(9):
        guard = judged(guard, sighting(T), attitude_of(T), True)
    return guard


@pytest.mark.parametrize(
    ("expected", "verdict"),
    [
        (None, Verdict.ELSEWHERE), (estimate((1.0, 0.5, 2.0), 0.1), Verdict.ELSEWHERE), (estimate((1.0, -0.5, 2.0), 0.1), None),
        (estimate((1.0, -0.2, 2.0), 0.1), None), (estimate((1.0, -0.1, 2.0), 0.001), Verdict.ELSEWHERE),
    ],
)  # fmt: skip
def test_another_place_is_refused_unless_the_estimate_expects_it(expected, verdict):
    guard, found = see(followed(), sighting(T + 0.5, (1.0, -0.5, 2.0)), attitude_of(T + 0.5), expected)
    assert (found, len(guard.tracks.candidates)) == (verdict, verdict is not None)


@pytest.mark.parametrize(("adrift", "beside_m", "taken"), [(True, 2.9, True), (True, 3.1, False), (False, 2.9, False)])
def test_a_pad_that_its_ship_swung_out_of_sight_goes_on_where_the_estimate_can_have_it(adrift, beside_m, taken):
    swung = replace(estimate((1.0, 0.5, 2.0), 0.6), adrift=adrift)
    guard, verdict = see(followed(), sighting(T + 0.5, (1.0 + beside_m, 0.5, 2.0)), attitude_of(T + 0.5), swung)
    assert (verdict, guard.tracks.number) == (None if taken else Verdict.ELSEWHERE, 1)
    assert bool(guard.tracks.candidates) is not taken


@pytest.mark.parametrize(
    ("d", "sigma_m", "step_m", "excluded"),
    [
        ((1.0, 0.5, 2.0), 0.02, 0.06, False), ((1.0, 0.89 - 1e-6, 2.0), 0.02, 0.06, False),
        ((1.0, 0.89 + 1e-6, 2.0), 0.02, 0.06, True), ((1.0, 0.5, 2.6), 0.02, 0.06, True), ((1.0, 0.92, 2.0), 0.2, 0.06, False),
        ((1.0, 0.92, 2.0), 0.02, 0.4, False),
    ],
    ids=["there", "nearer than half of two pads", "as far", "in height", "an uncertain estimate", "as the settings have it"],
)  # fmt: skip
def test_an_estimate_excludes_where_another_pad_can_be_and_it_does_not_expect_this_one(d, sigma_m, step_m, excluded):
    assert excludes(estimate((1.0, 0.5, 2.0), sigma_m), sighting(T, d), tuned(IntegrityOptions, place_step_m=step_m)) is excluded


def test_a_sightings_stamp_is_judged_before_its_place() -> None:
    guard, verdict = see(followed(), sighting(T + 2, (9.0, 0.0, 2.0)))
    assert (verdict, guard.tracks, guard.clock.rival is not None) == (Verdict.TOO_NEW, followed().tracks, True)
    guard = IntegrityGuard()
    for i in range(10):
        guard, verdict = see(guard, sighting(T + 1e-3 * i))
        assert verdict is None
    late, verdict = see(guard, sighting(T + 0.01, (9.0, 0.0, 2.0), delay_s=0.16))
    assert (verdict, late.tracks, alerts(late, NOW)) == (Verdict.TOO_OLD, guard.tracks, (IntegrityAlert.STAMPS,))
    assert alerts(guard, NOW) == ()


@pytest.mark.parametrize(("flying", "held_s", "kept"), [(True, 4, True), (False, 4, False), (True, 2, False)])
def test_a_delay_that_has_held_in_flight_is_kept_until_the_vehicle_stands(flying: bool, held_s: int, kept: bool) -> None:
    guard = IntegrityGuard(flying=flying)
    for i in range(10 * (held_s + 12)):
        guard, verdict = see(guard, sighting(T + 0.1 * i, delay_s=0.09 if i < 10 * held_s else 0.39))
    assert (verdict is Verdict.TOO_OLD, IntegrityAlert.STAMPS in alerts(guard, ns(T + 0.1 * i))) == (kept, kept)


@pytest.mark.parametrize(("flying", "known", "verdict"), [(True, True, Verdict.FROZEN), (False, True, None), (True, False, None)])
def test_a_view_that_stands_still_while_the_body_turns_is_refused_in_flight(flying, known, verdict):
    guard, found = IntegrityGuard(flying=flying), None
    for i in range(12):
        at = attitude_of(T + 0.04 * i, 0.02 * (-1) ** i)
        x, y, z = (at.R_ned_body.without_heading() @ np.array([0.1, 0.0, 2.0])).tolist()
        seen = sighting(T + 0.04 * i, (x, y, z))
        guard, found = see(guard, seen, at if known else None)
        guard = judged(guard, seen, None, True)
    assert found is verdict


@pytest.mark.hazard("H1")
@pytest.mark.parametrize(("leap_m", "height_m"), [(0.2, 0.6), (0.25, 1.0), (0.25, 2.5), (0.37, 1.8), (0.8, 2.5)])
def test_a_pad_in_sight_that_leaps_is_another_one_however_near_it_is(leap_m: float, height_m: float) -> None:
    """WHY: everything 37 cm aside, less than half of the distance of two pads, was landed on with the feet over the rim."""
    rng, guard, n, at = np.random.default_rng(4), IntegrityGuard(), 0, attitude_of(T)
    while guard.tracks.number < 2:
        t, leapt = T + 0.033 * n, n >= 60
        x, y, z = rng.normal((0.1 + leap_m * leapt, 0.0, height_m), 0.01).tolist()
        seen = make.sighting(t, (x, y, z))
        guard, verdict = see(guard, seen, at, replace(estimate((0.1, 0.0, height_m), 0.02), at=ns(t)))
        # The filter refuses what is ten of its deviations away.
        guard = judged(guard, seen, at, is_fused=not leapt) if verdict is None else guard
        n += 1
        assert n < 60 + 3.0 * 30
    assert n > 60 + 1.9 * 30


def test_a_pad_above_a_camera_that_looks_down_is_impossible_and_changes_nothing() -> None:
    before = followed()
    guard, verdict = see(before, sighting(T + 0.033, (1.0, 0.5, -2.0)), attitude_of(T))
    assert (verdict, guard is before) == (Verdict.IMPOSSIBLE, True)
    assert see(IntegrityGuard(), sighting(T, (0.0, 0.0, -0.1)), attitude_of(T))[1] is None, "it stands on it"


@pytest.mark.parametrize(
    ("tilts_to_deg", "aside_m", "verdict"), [(20.0, 0.0, None), (20.0, 0.78, Verdict.ELSEWHERE), (0.0, 0.78, Verdict.ELSEWHERE)]
)
def test_a_pad_that_was_followed_without_an_attitude_is_known_again_whatever_the_tilt_is_by_then(tilts_to_deg, aside_m, verdict):
    """Own truth: the body tilts while its attitude is not known, which moves the place that is assumed by 1.1 m."""
    p, guard = np.array([0.2, 0.1, 3.0]), IntegrityGuard(options=tuned(IntegrityOptions, view_turned_min_rad=1.0))
    times = [T + 0.033 * n for n in range(83)]
    for t in times[:20]:
        guard, found = see(guard, sighting(t, (0.2, 0.1, 3.0)), attitude_of(t))
        assert found is None
        guard = judged(guard, sighting(t, (0.2, 0.1, 3.0)), attitude_of(t), True)
    for n, t in enumerate(times[20:81]):
        x, y, z = Rotation.from_rpy(math.radians(tilts_to_deg) * n / 60, 0.0, 0.0).inv @ p
        guard = follow(guard, sighting(t, (x, y, z)), attitude_of(T))
    assert (guard.tracks.last.t, guard.tracks.n) == (ns(times[80]), 20), "followed, and no sighting of the track"
    verdicts = []
    for t in times[81:]:
        now = attitude_of(t, math.radians(tilts_to_deg))
        guard, found = see(guard, sighting(t, (0.2 + aside_m, 0.1, 3.0)), now, estimate((-2.0, 0.0, 4.0), 0.01))
        guard, _ = admit_one(guard, now)
        verdicts.append(found)
    assert verdicts == [Verdict.TOO_NEW, verdict], "followed also while the first stamp after the silence is doubted"
    assert guard.tracks.number == 1


# Every alert is raised and ends

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
        return stamp(t - late_s, late_s)

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
        attitude_of = min(self._attitudes[-20:], key=lambda each: abs(each.stamp.measured_at * 1e-9 - at))
        R, level = self._body(at).without_heading(), attitude_of.R_ned_body.without_heading()
        d_body = R.inv @ PAD
        if fault is IntegrityAlert.VIEW_FROZEN:
            d_body = PAD
        if fault is IntegrityAlert.VIEW_REVERSED:
            d_body = MIRROR @ d_body
        d = level @ d_body + 0.002 * self._rng.standard_normal(3)
        if fault is IntegrityAlert.ELSEWHERE:
            d = d + np.array([1.0, 0.0, 0.0])
        exposed = self._stamp(t, LATE_S + (0.3 if fault is IntegrityAlert.STAMPS else 0.0))
        pose = Pose6(d, level @ R.inv, 1e-4 * np.eye(6))
        seen = make.sighting(exposed, d, -0.3, seq=self.n, method="registration", pose6=pose)
        believed = d + np.array([1.5, 0.0, 0.0]) if fault is IntegrityAlert.APART else PAD
        belief = RelativeState(
            exposed.measured_at, "ekf", believed, np.zeros(3), 0.0, 1e-4 * np.eye(7), exposed.measured_at, consistent=True
        )
        self.guard, verdict = admit_sighting(self.guard, seen, attitude_of, belief)
        if verdict is None:
            self.guard = judged(self.guard, seen, attitude_of, is_fused=True)


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
    elsewhere = {IntegrityAlert.UNFELT, IntegrityAlert.DECK, IntegrityAlert.BASELINE}
    assert set(IntegrityAlert) - set(STREAMS) == elsewhere, "guidance raises two, and test_baselines.py tries one"
