"""The pilot over made-up senses: what it may never do, and who has the last word."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from companion.base.mission import FlightOutcome
from companion.guidance.landing import PilotOptions
from companion.guidance.make_pilot import make_pilot
from companion.guidance.mission.cycle import GuidanceCycle
from companion.guidance.mission.machine import mission_step
from companion.guidance.mission.progress import Progress
from companion.guidance.pilot import Pilot
from companion.settings.guidance import FollowDeckOptions, GuidanceOptions
from companion.settings.load import load
from estimator.contracts.commands import Hover
from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geodesy import GeoPoint
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, BodyVelocity, GeoFix, Imu, Sample, VehicleStatus, VesselReport
from estimator.contracts.time import MonoNs, Stamp, after
from estimator.options import EstimatorOptions
from estimator.vision.detection import Detection
from tests.companion.test_safety import EYES, TICK_S, Loop
from tests.make import ns, status


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


def test_the_ship_s_own_word_does_not_break_the_vehicle_s_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = Loop()
    loop.tick()
    cycles: list[GuidanceCycle] = []

    def seen(progress: Progress, s: GuidanceCycle, *args: Any, **kwargs: Any) -> Any:
        cycles.append(s)
        return mission_step(progress, s, *args, **kwargs)

    monkeypatch.setattr("companion.guidance.landing.mission_step", seen)
    for _ in range(50):
        loop.now = now = after(loop.now, TICK_S)
        stamp = Stamp(now, now, 0.001, "sim")
        loop.pilot.on_sample(GeoFix(stamp, "vessel", GeoPoint(0.9, 0.1, 0.0), 2.0))
        loop.pilot.on_sample(VesselReport(stamp, None, None, 0.5, 0.1))
        loop.pilot.decide(now)
    assert (cycles[-1].silent_s, cycles[-1].age_s) == pytest.approx((50 * TICK_S, 50 * TICK_S))
    for delay_s in (0.3, 0.4):
        late = Stamp(after(loop.now, -delay_s), loop.now, 0.001, "sim")
        loop.pilot.on_sample(Attitude(late, Rotation.identity(), 1e-5 * np.eye(3)))
        loop.pilot.decide(loop.now)
        assert (cycles[-1].silent_s, cycles[-1].age_s) == pytest.approx((0.0, 0.3)), "late samples break it and are still old"


@pytest.mark.parametrize(("own_deg", "flown_deg"), [(None, None), (25.0, 23.0), (45.0, 40.0)])
def test_the_vehicle_s_own_limit_of_the_tilt_counts_up_to_the_owner_s(own_deg: float | None, flown_deg: float | None) -> None:
    guidance, now = GuidanceOptions(follow_deck=FollowDeckOptions(tilt_max_deg=40.0)), MonoNs(0)
    pilot = Pilot(EYES, EstimatorOptions(), guidance, PilotOptions())
    pilot.on_sample(VehicleStatus(Stamp(now, now, 0.001, "sim"), True, "guided", 0.9, False, True, tilt_max_deg=own_deg))
    known = pilot.landing.knowledge(now, None, (None, None), lambda now, horizons_s: None)
    assert known.tilt_max_deg == flown_deg


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
        known = [pilot._knowledge(now, pilot.estimator.at(now)) for pilot in pilots]
        assert repr(known[0]) == repr(known[1])
        assert pilots[0].landing.vessel_counts() == pilots[1].landing.vessel_counts()


@pytest.mark.parametrize("outcome", [FlightOutcome.ABORTED, FlightOutcome.EMERGENCY, FlightOutcome.LANDED_BY_OTHERS])
def test_the_next_flight_begins_when_it_flies_after_having_stood(outcome: FlightOutcome) -> None:
    pilot = make_pilot(load("sim"))
    pilot.on_sample(status(0.0, True))
    pilot.decide(ns(0))
    if outcome is FlightOutcome.ABORTED:
        pilot.abort()
    else:
        pilot.on_sample(status(0.1, outcome is FlightOutcome.EMERGENCY, emergency=outcome is FlightOutcome.EMERGENCY))
        pilot.decide(ns(0.1))
    assert pilot.outcome is outcome
    if outcome is not FlightOutcome.LANDED_BY_OTHERS:
        pilot.on_sample(status(1.0, True))
        assert pilot.outcome is outcome, "still the same flight: nothing begins anew in the air"
        if outcome is FlightOutcome.ABORTED:
            assert pilot.decide(ns(1.0)).command == Hover()
    pilot.on_sample(status(2.0, False))
    assert pilot.outcome is outcome
    pilot.on_sample(status(3.0, True))
    assert pilot.outcome is None
    assert pilot.decide(ns(3.0)).phase != outcome.value
