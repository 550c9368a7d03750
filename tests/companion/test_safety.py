"""Dead or implausible inputs never keep the drone flying down: guard, estimator and guidance over random faults.

A body follows the commands; what it senses is frozen, displaced, misstamped, beyond reason or missing for spells drawn at random.
"""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from companion.base.observer import Decision
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.guidance.landing import PilotOptions
from companion.guidance.mission.progress import fit_to_steer
from companion.guidance.pilot import Pilot
from companion.settings.guidance import GuidanceOptions
from companion.settings.load import camera_model, load, pad_model
from companion.settings.mission import TryOptions
from estimator.contracts.commands import Hover, Land, Lean, Velocity
from estimator.contracts.estimates import IntegrityAlert, PathName, Sighting, Verdict
from estimator.contracts.geometry import GeoPoint, Rotation
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, BodyVelocity, Frame, GeoFix, Imu, Sample, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp, after
from estimator.options import EstimatorOptions
from estimator.vision.detection import Detection, PadCheck
from estimator.vision.options import TrackerOptions
from estimator.vision.track.config import TrackerConfig
from tests.make import attitude, deck, imu, range_down, stamp_at, status, velocity

SIM = load("sim")
EYES = TrackerConfig(camera_model(SIM), pad_model(SIM), TrackerOptions(colours="simulator"))
GUIDANCE = GuidanceOptions(mission="thesis", controller="pid")
TRIES = TryOptions()
TICK_S = 0.05
FAULTS = (
    "none", "camera frozen", "aside", "half aside", "no pad", "no frames", "stamps old", "imu frozen", "imu spikes",
    "accelerometer frozen", "attitude frozen", "velocity frozen", "hour ahead", "range wrong", "silent",
)  # fmt: skip


@dataclass
class Loop:
    """A pilot in a closed loop with a body over a pad that stands still."""

    path: PathName = "dead_reckoning"
    guidance: GuidanceOptions = GUIDANCE
    d: np.ndarray = field(default_factory=lambda: np.array([0.4, -0.3, 3.0]))
    v: np.ndarray = field(default_factory=lambda: np.zeros(3))
    verdicts: list[Verdict] = field(default_factory=list)
    lowest_m: float = math.inf
    glare: float = 0.0
    """Share of the pad that vision cannot see for glare."""
    automatic: bool = True
    flying: bool = True

    def __post_init__(self) -> None:
        options = PilotOptions(automatic=self.automatic)
        self.pilot = Pilot(EYES, EstimatorOptions(path=self.path), self.guidance, options)
        self.rng = np.random.default_rng(7)
        self.now = MonoNs(10**12)
        self.ticks = 0
        self.still_image = self.image()
        self.still_imu = (np.array([0.01, 0.02, 0.03]), np.array([0.1, 0.0, -9.8]))

    def image(self) -> np.ndarray:
        return self.rng.integers(0, 255, (32, 8, 3), dtype=np.uint8)

    def noise(self, sigma: float) -> np.ndarray:
        return self.rng.normal(0.0, sigma, 3)

    def tick(self, fault: str = "none") -> Decision:
        """One period: the body moves, senses, sees, and is told what to do."""
        self.ticks += 1
        self.now = after(self.now, TICK_S)
        if fault != "silent":
            self.sense(fault)
            if fault != "no frames":
                self.track(fault)
        decision = self.pilot.decide(self.now)
        wanted = np.array([0.0, 0.0, 0.4]) if isinstance(decision.command, Land) else np.zeros(3)
        if isinstance(decision.command, Velocity | Lean):
            wanted = decision.command.v_level
        self.v = self.v + (wanted - self.v) * min(1.0, TICK_S / 0.3)
        self.d = self.d - self.v * TICK_S
        self.lowest_m = min(self.lowest_m, float(self.d[2]))
        return decision

    def sense(self, fault: str) -> None:
        at = after(self.now, 3600.0) if fault == "hour ahead" and self.ticks % 7 == 0 else self.now
        stamp = stamp_at(at)
        w, f = self.noise(0.01), np.array([0, 0, -9.80665]) + self.noise(0.05)
        if fault == "imu frozen":
            w, f = self.still_imu
        if fault == "accelerometer frozen":
            f = self.still_imu[1]
        if fault == "imu spikes" and self.ticks % 5 == 0:
            f = np.array([0.0, 1e4, 0.0])
        self.pilot.on_sample(imu(stamp, w, f))
        now, tilt = stamp_at(self.now), np.zeros(3) if fault == "attitude frozen" else self.noise(0.002)
        self.pilot.on_sample(attitude(now, *tilt, var=1e-5))
        self.pilot.on_sample(velocity(now, np.zeros(3) if fault == "velocity frozen" else self.v + self.noise(0.01)))
        if self.d[2] > 0.2:
            wrong = 1.6 if fault == "range wrong" else 1.0
            self.pilot.on_sample(range_down(now, self.d[2] * wrong + abs(self.noise(0.005)[0])))
        self.pilot.on_sample(status(now, self.flying, "hovering"))

    def track(self, fault: str) -> None:
        late_s = 0.36 if fault == "stamps old" else 0.06
        stamp = stamp_at(after(self.now, -late_s), self.now, sigma_s=0.002)
        px = self.still_image if fault == "camera frozen" else self.image()
        if (refused := self.pilot.estimator.admit(Frame(stamp, self.ticks, px))) is not None:
            self.verdicts.append(refused)
            return
        aside = fault == "aside" or (fault == "half aside" and self.ticks % 2 == 0)
        if fault == "no pad" or self.d[2] < 0.2:
            self.verdicts.append(Verdict.NO_PAD)
            return
        d = self.d + self.v * 0.06 + self.noise(0.003) + (1.2 if aside else 0.0) * np.array([0.0, 1.0, 0.0])
        tilt = np.array([[0.0, -d[2]], [d[2], 0.0], [-d[1], d[0]]])  # how a tilt error moves it
        cov = np.diag([4e-5, 4e-5, 4e-5, 1e-3])
        cov[:3, :3] += 1e-5 * tilt @ tilt.T
        seen = Sighting(stamp, self.ticks, "registration", d, 0.1, False, cov, 0.9)
        on_pad = PadCheck(stamp.measured_at, 1.0, glare=self.glare)
        self.verdicts.append(self.pilot.on_detection(Detection(seen, "registration", {}, on_pad=on_pad))[0])

    def until(self, done, fault: str = "none", seconds: float = 60.0) -> Decision:
        for _ in range(round(seconds / TICK_S)):
            decision = self.tick(fault)
            if done(decision):
                return decision
        raise AssertionError(f"not within {seconds} s: {self.pilot.state.value}, {self.pilot.landing.reason}, {self.d}")


def descends(decision: Decision) -> bool:
    return isinstance(decision.command, Velocity) and decision.command.v_level[2] > 1e-9


def below(height_m: float, loop: Loop):
    return lambda decision: loop.d[2] < height_m


@pytest.mark.hazard("H1")
@settings(max_examples=12)
@given(
    spells=st.lists(st.tuples(st.integers(2, 80), st.sampled_from(FAULTS)), min_size=1, max_size=5),
    path=st.sampled_from(["dead_reckoning", "median_mean", "ekf"]),
    pause_at=st.integers(0, 400),
)
def test_no_history_of_faults_makes_it_descend_without_a_fresh_consistent_estimate_of_its_pad(spells, path, pause_at):
    loop, flown, landing_s, around = Loop(path), None, 0.0, 0
    loop.until(below(2.4, loop))
    before = loop.pilot.state.value
    for ticks, fault in spells:
        for _ in range(ticks):
            decision = loop.tick(fault)
            belief = decision.belief
            fit = belief is not None and fit_to_steer(belief, decision.at, GUIDANCE.stale_after_s)
            if fit and flown is None:
                flown = belief.track
            lands = isinstance(decision.command, Land)
            if descends(decision) or (lands and not landing_s):
                assert fit, (decision, fault)
                assert not belief.alerts
                assert belief.track == flown
            landing_s = landing_s + TICK_S if lands else 0.0
            assert landing_s <= GUIDANCE.land_timeout_s + 2 * TICK_S
            around += loop.pilot.state.value in ("go around",) and before not in ("go around",)
            assert around <= 2 * (TRIES.go_arounds_max + 1)
            before = loop.pilot.state.value
            if loop.ticks == pause_at:
                loop.pilot.hold()
                assert not descends(paused := loop.tick(fault)) or fit_to_steer(paused.belief, paused.at, GUIDANCE.stale_after_s)
                loop.pilot.begin()
                flown, around, landing_s = None, 0, 0.0


@pytest.mark.hazard("H6")
@pytest.mark.parametrize("word", ["hold", "abort"])
def test_the_operator_has_the_last_word_even_over_a_landing(word: str) -> None:
    loop = Loop()
    loop.until(lambda decision: isinstance(decision.command, Land))
    getattr(loop.pilot, word)()
    for _ in range(50):
        decision = loop.tick()
        assert not isinstance(decision.command, Land)
        assert not descends(decision)


def test_a_camera_that_freezes_is_refused_reported_and_not_descended_by() -> None:
    loop = Loop()
    loop.until(below(1.5, loop))
    reported = loop.until(lambda decision: IntegrityAlert.CAMERA_FROZEN.value in decision.reason, "camera frozen", seconds=0.4)
    assert not reported.belief.consistent
    for _ in range(40):
        assert not descends(loop.tick("camera frozen"))
    assert loop.verdicts[-1] is Verdict.REPEATED
    assert loop.lowest_m > 1.2
    loop.until(lambda decision: decision.phase == "gave up", "camera frozen")
    assert loop.d[2] == pytest.approx(TRIES.safe_height_m, abs=0.4)


@pytest.mark.hazard("H2")
@pytest.mark.parametrize("path", ["dead_reckoning", "median_mean", "ekf"])
def test_frames_of_another_place_end_in_a_question_from_the_safe_height(path: PathName) -> None:
    loop = Loop(path)
    loop.until(below(1.2, loop))
    loop.until(lambda decision: decision.phase == "another pad", "aside", seconds=10.0)
    assert loop.verdicts.count(Verdict.ELSEWHERE) > 10
    for _ in range(400):
        assert not descends(loop.tick("aside"))
    assert loop.d[2] == pytest.approx(TRIES.safe_height_m, abs=0.4)
    assert abs(loop.d[1]) < 0.5
    reported = loop.pilot.belief(loop.now)
    assert IntegrityAlert.ELSEWHERE in reported.alerts, "no autopilot is led to it either"
    loop.pilot.begin()
    loop.until(lambda decision: isinstance(decision.command, Land), "aside")
    assert loop.d[1] == pytest.approx(-1.2, abs=0.2), "the operator took the other pad"


@pytest.mark.hazard("H1")
@pytest.mark.parametrize(
    ("fault", "alert"),
    [
        ("imu frozen", IntegrityAlert.IMU_FROZEN),
        ("attitude frozen", IntegrityAlert.ATTITUDE_FROZEN),
        ("half aside", IntegrityAlert.ELSEWHERE),
        ("range wrong", IntegrityAlert.RANGE),
        ("stamps old", IntegrityAlert.STAMPS),
    ],
)
def test_what_is_dead_or_contradicts_stops_the_descent_and_is_reported(fault: str, alert: IntegrityAlert) -> None:
    loop = Loop()
    loop.until(below(1.8, loop))
    loop.until(lambda decision: alert.value in decision.reason, fault, seconds=2.0)
    height_m = loop.d[2]
    for _ in range(60):
        decision = loop.tick(fault)
        assert not descends(decision)
        assert not isinstance(decision.command, Land)
    assert loop.lowest_m > height_m - 0.25
    loop.until(lambda decision: isinstance(decision.command, Land), seconds=90.0)


@pytest.mark.hazard("H1")
def test_half_an_imu_that_is_dead_is_reported_and_after_a_second_nobody_descends_until_it_lives() -> None:
    loop = Loop("ekf")
    loop.until(below(2.4, loop))
    words = "the accelerometer repeats its readings; flying without it"
    reported = loop.until(lambda decision: words in decision.reason, "accelerometer frozen", seconds=0.4)
    assert reported.belief.consistent
    loop.until(lambda decision: IntegrityAlert.UNFELT.value in decision.reason, "accelerometer frozen", seconds=1.2)
    for _ in range(60):
        assert not descends(loop.tick("accelerometer frozen"))
    loop.until(lambda decision: isinstance(decision.command, Land), seconds=90.0)


@pytest.mark.parametrize("fault", ["imu spikes", "hour ahead", "velocity frozen"])
def test_what_can_be_left_out_is_refused_and_the_landing_goes_on(fault: str) -> None:
    loop = Loop("ekf")
    loop.until(below(2.4, loop))
    loop.until(lambda decision: isinstance(decision.command, Land), fault)
    assert np.hypot(*loop.d[:2]) < 0.2


@pytest.mark.hazard("H1", "H7")
def test_a_deck_that_would_move_as_none_does_leads_nobody_down_nor_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lying accelerometer makes the filter estimate a deck that rises ever faster; the drone followed it up at 1 m/s."""
    loop = Loop("ekf")
    loop.until(below(2.4, loop))
    moves = loop.pilot.estimator.motion
    rises = deck(loop.now * 1e-9, (0.0, 0.0, -8.0))
    monkeypatch.setattr(loop.pilot.estimator, "motion", lambda now: (moves(now)[0], rises))
    height_m = loop.d[2]
    for _ in range(40):
        decision = loop.tick()
        assert not descends(decision)
        assert IntegrityAlert.DECK in decision.belief.alerts
        reported = loop.pilot.belief(loop.now)
        assert not reported.consistent
    assert IntegrityAlert.DECK.value in decision.reason
    assert loop.d[2] < height_m + 1.5, "it follows no such deck up"
    monkeypatch.undo()
    loop.until(lambda decision: isinstance(decision.command, Land), seconds=90.0)


@pytest.mark.parametrize("passes", [True, False], ids=["glare that passes", "the operator looks"])
def test_a_pad_in_glare_is_not_landed_upon_before_it_is_seen_or_called_clear(passes: bool) -> None:
    loop = Loop("ekf", GuidanceOptions(mission="cone", controller="pid"))
    loop.glare = 0.31
    loop.until(lambda decision: loop.pilot.state.value == "gate" and "31 % of the pad is in glare" in decision.reason)
    for _ in range(60):
        loop.tick()
        assert loop.pilot.state.value not in ("commit", "press", "down")
    if passes:
        loop.glare = 0.0
    else:
        assert loop.pilot.operator.take(OperatorOrder.CLEAR, OrderSender(OrderSource.PAGE), loop.now).accepted
    loop.until(lambda decision: loop.pilot.state.value == "commit")


# The pilot's own: frames and samples as they come


def test_it_leaves_the_vehicle_alone_until_it_flies_and_hovers_until_it_sees() -> None:
    loop = Loop(flying=False)
    assert loop.tick().command is None
    loop.flying = True
    commands = {type(loop.tick("no frames").command) for _ in range(64)}
    assert commands == {Hover}, "its ultrasound would find a deck that is near"


@pytest.mark.hazard("H2")
def test_a_pad_elsewhere_is_for_the_guard_to_judge_with_the_tracked_one_and_without() -> None:
    loop = Loop()
    for _ in range(60):
        loop.tick()

    def judged(tracked: float | None) -> Verdict:
        stamp = Stamp(after(loop.now, -0.04), loop.now, 0.001, "sim")
        here = Sighting(stamp, 1, "registration", loop.d, 0.1, False, np.diag([1e-4, 1e-4, 1e-4, 1e-3]), tracked or 0.0)
        there = structs.replace(here, d_body_pad_level=loop.d + np.array([0.0, 1.5, 0.0]), confidence=0.9)
        selected = None if tracked is None else here
        return loop.pilot.on_detection(Detection(selected, "registration", {}, elsewhere=there))[0]

    assert [judged(tracked) for tracked in (None, 0.1, 0.4)] == [Verdict.ELSEWHERE, Verdict.ELSEWHERE, Verdict.FUSED]


@settings(max_examples=10)
@given(cuts=st.lists(st.integers(1, 9), min_size=1, max_size=8), flies_from=st.integers(0, 30), seed=st.integers(0, 9))
def test_samples_together_fly_as_samples_one_by_one(cuts: list[int], flies_from: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pilots = [Loop().pilot for _ in range(2)]
    samples: list[Sample] = []
    for n in range(60):
        stamp = Stamp(MonoNs(n * 5_000_000), MonoNs(n * 5_000_000 + 1_000_000), 0.001, "sim")
        push = 40.0 if rng.uniform() < 0.05 else 0.0
        roll, pitch, yaw = rng.normal(0.0, 0.05, 3)
        samples += [
            VehicleStatus(stamp, n >= flies_from, "hovering", 0.9, False, True),
            Attitude(stamp, Rotation.from_rpy(roll, pitch, yaw), 1e-5 * np.eye(3)),
            Imu(stamp, rng.normal(0.0, 1e-3, 3), np.array([0.0, 0.0, -9.80665 - push])),
            BodyVelocity(stamp, np.array([*rng.normal(0.0, 0.5, 2), 0.0]), np.diag([0.01, 0.01, UNKNOWN_VAR])),
            GeoFix(stamp, "vehicle" if n % 2 else "vessel", GeoPoint(0.9, 0.1, 2.0), 2.0),
        ]
    while samples:
        n = cuts[len(samples) % len(cuts)]
        some, samples = samples[:n], samples[n:]
        together, one_by_one = pilots[0].on_samples(some), [pilots[1].on_sample(sample) for sample in some]
        assert [[r.verdict for r in of_one] for of_one in together] == [[r.verdict for r in of_one] for of_one in one_by_one]
        now = after(some[-1].stamp.received_at, 0.001)
        assert repr(pilots[0].decide(now)) == repr(pilots[1].decide(now))
        known = [pilot.landing.knowledge(now, pilot.estimator.at(now), pilot.estimator) for pilot in pilots]
        assert repr(known[0]) == repr(known[1])
        assert pilots[0].landing.vessel_track.counted() == pilots[1].landing.vessel_track.counted()
