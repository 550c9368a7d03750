"""Each fault by its effect on what comes out of the simulated drone: readings, frames, stamps, the vehicle itself."""

import itertools
import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray

from companion.base.mission import State
from companion.base.observer import Decision
from companion.guidance.pilot import make_pilot
from companion.settings.load import load as load_settings
from drivers.ardrone.navdata_channel import NavdataOrder
from drivers.ardrone.navdata_channel import SequencePlace as P
from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.commands import Hover
from estimator.contracts.errors import BadInput, SetupImpossible
from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Imu
from estimator.contracts.time import MonoNs, after
from sitl.ardrone.flight import Flight
from sitl.faults import kinds
from sitl.faults.fault import Fault, FaultTimer
from sitl.faults.faulty_streams import FaultyStream, InTransit
from sitl.faults.readings import (
    Accelerometer,
    AttitudeReading,
    Barometer,
    Gyro,
    HeadingReading,
    Magnetometer,
    NavdataMisstamped,
    Ultrasound,
    VelocityReading,
)
from sitl.perception.levels import perceive
from sitl.scenario.scenario import from_mapping, pad_model
from sitl.sensors.sensors import Readings
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.truth import RenderedFrame
from sitl.world.world import Stick, World
from tests.fly import ObservedCalls, fly_for, near, new_flight
from tests.make import change, tuned

CALM = near(start={"height_m": 3.0})
SIM = load_settings("sim")


def world(*faults: Fault, seed: int = 1) -> World:
    return World(msgspec.structs.replace(CALM, faults=faults), seed)


def at(w: World, seconds: float) -> World:
    w.advance(after(w.started, seconds))
    return w


def both(fault: Fault, seconds: float) -> tuple[Readings, Readings]:
    """Return the same instant with the fault and without."""
    return at(world(fault), seconds).readings(), at(world(), seconds).readings()


def changed_readings(one: Readings, other: Readings) -> set[str]:
    return {f for f in Readings.__struct_fields__ if not np.array_equal(getattr(one, f), getattr(other, f))}


QUARTER = math.pi / 2
ADDED: list[tuple[Fault, str, float | list[float]]] = [
    (Accelerometer(at_s=0.5, axis="x", offset_m_s2=3.0), "f_body", [3.0, 0.0, 0.0]),
    (Accelerometer(at_s=0.5, axis="z", offset_m_s2=1e4), "f_body", [0.0, 0.0, 1e4]),
    (Accelerometer(at_s=0.5, drift_m_s3=2.0), "f_body", [0.6, 0.6, 0.6]),
    (Gyro(at_s=0.5, axis="y", offset_deg_s=90.0), "w_body", [0.0, QUARTER, 0.0]),
    (AttitudeReading(at_s=0.5, roll_deg=9.0), "rpy_rad", [QUARTER / 10.0, 0.0, 0.0]),
    (AttitudeReading(at_s=0.5, pitch_deg=-3.0), "rpy_rad", [0.0, -QUARTER / 30.0, 0.0]),
    (VelocityReading(at_s=0.5, axis="y", offset_m_s=1.5), "v_level_m_s", [0.0, 1.5]),
    (Magnetometer(at_s=0.5, axis="x", offset_ut=5.0), "magnetometer", [5e-6, 0.0, 0.0]),
    (Ultrasound(at_s=0.5, offset_m=-0.5), "ultrasound_m", -0.5),
    (Barometer(at_s=0.5, offset_pa=24.0), "pressure_pa", 24.0),
    (NavdataMisstamped(at_s=0.5, by_s=-2.0), "at", -2e9),
]
GIVEN: list[tuple[Fault, str, float | None]] = [
    (Gyro(at_s=0.5, axis="z", scale=0.0), "w_body", 0.0),
    (Accelerometer(at_s=0.5, limit_m_s2=1.0), "f_body", -1.0),
    (Ultrasound(at_s=0.5, dropped_fraction=1.0), "ultrasound_m", None),
    (Magnetometer(at_s=0.5, dropped_fraction=1.0), "magnetometer", None),
]
"""Numbers that a faulty sensor adds to its reading, and those that it gives as the last of its values."""


def test_a_faulty_sensor_changes_its_own_reading_by_so_much_and_no_other() -> None:
    for fault, field, expected in [*ADDED, *GIVEN]:
        faulty, true = both(fault, 0.8)
        assert changed_readings(faulty, true) == {field}, fault
        value = getattr(faulty, field)
        if (fault, field, expected) in ADDED:
            assert np.subtract(value, getattr(true, field)) == pytest.approx(expected, abs=1e-9), fault
        else:
            assert (value if value is None else np.atleast_1d(value)[-1]) == expected, fault
        assert changed_readings(*both(fault, 0.49)) == set()


def test_a_low_battery_goes_on_falling_as_it_is_flown_and_its_report_with_it() -> None:
    """WHY: it stood still at its fraction, so that no last charge ever came (weather_3, 894201)."""
    low = world(kinds.LowBattery(at_s=0.5, fraction=0.05))
    for seconds in (0.8, 12.5):
        at(low, seconds)
        assert low.battery == low.readings().battery_fraction == pytest.approx(0.05 - (seconds - 0.5) / 1200.0, abs=1e-5)


def test_a_heading_offset_turns_the_compass_and_its_field_alike() -> None:
    faulty, true = both(HeadingReading(at_s=0.5, offset_deg=60.0, drift_deg_s=15.0), 1.5)
    assert changed_readings(faulty, true) == {"rpy_rad", "magnetometer"}
    assert math.degrees(faulty.rpy_rad[2] - true.rpy_rad[2]) % 360.0 == pytest.approx(75.0, abs=0.1)
    (north, east, _), (faulty_north, faulty_east, _) = true.magnetometer, faulty.magnetometer
    turned = math.atan2(east, north) - math.atan2(faulty_east, faulty_north)
    assert math.degrees(turned) % 360.0 == pytest.approx(75.0, abs=0.1)
    assert faulty.magnetometer[2] == true.magnetometer[2]


@pytest.mark.parametrize(
    ("fault", "held", "free"),
    [
        (Accelerometer(at_s=0.5, for_s=1.0, frozen=True), "f_body", "rpy_rad"),
        (Ultrasound(at_s=0.5, for_s=1.0, frozen=True), "ultrasound_m", "f_body"),
    ],
)
def test_a_frozen_sensor_repeats_its_last_reading_until_the_fault_is_over(fault: Fault, held: str, free: str) -> None:
    w = world(fault)
    w.stick(Stick(gaz=0.5, progressive=True))
    at(w, 0.52)
    first = w.readings()
    second = at(w, 1.4).readings()
    assert np.array_equal(getattr(first, held), getattr(second, held))
    assert not np.array_equal(getattr(first, free), getattr(second, free))
    assert second.at > first.at
    assert not np.array_equal(getattr(second, held), getattr(at(w, 1.6).readings(), held))


def test_a_delayed_sensor_reports_what_was_true_before() -> None:
    w, true = world(Barometer(at_s=0.0, delay_s=0.4)), world()
    reported, past = list[float](), list[float]()
    for tick in range(1, 301):
        for each, out in ((w, reported), (true, past)):
            out.append(at(each, 0.004 * tick).readings().pressure_pa)
    assert reported[200:] == past[100:200]


def test_dropped_and_noisy_readings_follow_the_seed() -> None:
    def flown(seed: int) -> tuple[list[float], float]:
        faults = Gyro(at_s=0.0, dropped_fraction=0.3), Accelerometer(at_s=0.0, axis="y", noise_m_s2=2.0)
        w, true = world(*faults, seed=seed), world(seed=seed)
        rates, noise = [], []
        for tick in range(1, 401):
            faulty, right = at(w, 0.004 * tick).readings(), at(true, 0.004 * tick).readings()
            assert faulty.f_body[0] == right.f_body[0]
            rates.append(float(faulty.w_body[0]))
            noise.append(faulty.f_body[1] - right.f_body[1])
        return rates, float(np.std(noise))

    rates, sigma = flown(1)
    repeated = np.mean(np.diff(rates) == 0.0)
    assert 0.22 < repeated < 0.38
    assert sigma == pytest.approx(2.0, rel=0.12)
    assert flown(1)[0] == rates
    assert flown(2)[0] != rates


def test_a_recurring_fault_begins_as_often_as_it_says_and_never_overlaps_itself() -> None:
    timer, other = (
        FaultTimer((kinds.FlowBlind(per_minute=30.0, for_s=0.5),), 4),
        FaultTimer((kinds.FlowBlind(per_minute=30.0, for_s=0.5),), 5),
    )
    for tick in range(60_000):
        timer.update(0.01 * tick, 3.0, None)
        other.update(0.01 * tick, 3.0, None)
    times = [began_s for _, began_s in timer.begun]
    assert len(times) == pytest.approx(600.0 / (2.0 + 0.5), rel=0.2)
    assert min(np.diff(times)) >= 0.5
    assert times != [began_s for _, began_s in other.begun]
    with pytest.raises(ValueError, match="for_s must say"):
        kinds.FlowBlind(per_minute=3.0)


def fly_calm(fault: Fault, seconds: float = 1.2) -> tuple[Flight, ObservedCalls]:
    calls = ObservedCalls()
    return fly_for(seconds, CALM, observers=[calls], faults=(fault,)), calls


def test_delayed_frames_come_late_with_true_stamps_and_misstamped_ones_in_time_with_wrong_stamps() -> None:
    _, late = fly_calm(kinds.FrameStream(at_s=0.5, delay_s=0.3))
    delays = [f.frame.stamp.delay_s for f in late.frames]
    assert delays[0] == pytest.approx(0.09, abs=0.005)
    assert delays[-1] == pytest.approx(0.39, abs=0.005)
    _, wrong = fly_calm(kinds.FramesMisstamped(at_s=0.5, by_s=-0.3))
    assert wrong.frames[-1].frame.stamp.delay_s == pytest.approx(0.39, abs=0.005)
    assert len(wrong.frames) > len(late.frames) + 5
    _, ahead = fly_calm(kinds.FramesMisstamped(at_s=0.5, by_s=2.0))
    assert max(f.frame.stamp.measured_at for f in ahead.frames) > 2_900_000_000


def test_a_lost_link_carries_nothing_either_way() -> None:
    flight, processed = fly_calm(kinds.LinkLost(at_s=0.3), 3.0)
    assert max(s.stamp.received_at for s in processed.samples) < 320_000_000
    assert max(f.frame.stamp.measured_at for f in processed.frames) < 320_000_000
    assert flight._drone.state.silent, "the drone misses its client"


def test_a_killed_service_does_nothing_and_a_new_one_remembers_nothing() -> None:
    flight, processed = fly_calm(kinds.ServiceKilled(at_s=0.5), 3.0)
    assert max(s.stamp.received_at for s in processed.samples) < 510_000_000
    assert not flight._drone.state.silent, "its sender is another process and holds the drone"
    assert flight.world.phase is VehiclePhase.HOVERING
    first = flight.pilot
    again, processed = fly_calm(kinds.ServiceKilled(at_s=0.5, for_s=0.5), 1.2)
    assert again.pilot is not first
    received_at = np.array([s.stamp.received_at for s in processed.samples]) / 1e9
    assert np.diff(received_at).max() == pytest.approx(0.5, abs=0.02)
    with pytest.raises(BadInput, match="service_killed comes back after for_s"):
        Flight(change(CALM, faults=(kinds.ServiceKilled(at_s=0.5, for_s=0.5),)), 1, SIM, make_pilot(SIM))


def test_a_refusal_says_what_guidance_reported_and_what_became_of_the_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    flight, _ = fly_calm(kinds.LensCovered(at_s=0.0), 0.2)
    pilot = flight.pilot

    def gives_up(now: MonoNs) -> Decision:
        pilot.landing.mission = replace(pilot.landing.mission, state=State.GAVE_UP)
        return Decision(now, "gave up", Hover(), None, (), "the pad was not found again")

    monkeypatch.setattr(pilot, "decide", gives_up)
    while flight.step():
        pass
    judged = flight.result().judged
    refused = judged.refused
    assert refused.startswith("the pad was not found again; frames since the pad was last truly seen: ")
    assert "no_pad" in refused
    assert judged.grade == "failed", "this scenario expects a landing"


def test_the_simulated_drone_takes_every_key_of_the_configuration_or_the_run_ends() -> None:
    flight, _ = fly_calm(kinds.FlowBlind(at_s=9.0), 0.02)
    assert flight.world.limits.euler_angle_max_rad == pytest.approx(math.radians(SIM.vehicle.tilt_max_deg), abs=1e-5)
    assert flight._drone.state.counters["config_set"] == 11
    values = msgspec.structs.asdict(SIM.vehicle)
    steep = msgspec.structs.replace(SIM, vehicle=tuned(ArDroneOptions, **values, com_watchdog_s=61))
    with pytest.raises(SetupImpossible, match="refused the configuration key general:com_watchdog: bad_value"):
        Flight(CALM, 1, steep, make_pilot(steep))


def on_at(timer: FaultTimer, heights: list[float], phases: list[str | None] | None = None) -> list[bool]:
    out = []
    for n, height in enumerate(heights):
        timer.update(0.1 * n, height, phases[n] if phases else None)
        out.append(bool(timer.now))
    return out


def test_a_fault_begins_at_a_height_or_in_a_phase_once_and_lasts() -> None:
    below = FaultTimer((kinds.FlowBlind(below_height_m=1.0, for_s=0.2),))
    assert on_at(below, [0.3, 0.8, 1.2, 0.9, 1.5, 0.8, 0.5]) == [False, False, False, True, True, False, False]
    above = FaultTimer((kinds.FlowBlind(above_height_m=1.0),))
    assert on_at(above, [0.3, 1.2, 0.9]) == [False, True, True]
    phase = FaultTimer((kinds.FlowBlind(in_phase="descend"),))
    assert on_at(phase, [3.0] * 4, [None, "intercept", "descend", "hold blind"]) == [False, False, True, True]


TICK_NS = 10_000_000


def carried(*faults: kinds.StreamFault | kinds.LinkLost, seed: int = 1, packets: int = 400) -> list[tuple[int, MonoNs]]:
    """Send a packet each 10 ms over a stream of frames; return number and time of each arrival."""
    timer = FaultTimer(faults, seed)
    transit: InTransit[int] = InTransit(FaultyStream(timer, "frames", seed))
    out = []
    for n in range(packets + 200):
        now = MonoNs(n * TICK_NS)
        timer.update(n * 0.01, 3.0, None)
        if n < packets:
            transit.send(lambda n=n: n, now, 0.02)  # type: ignore[misc]
        while (packet := transit.arrived(now)) is not None:
            out.append((packet[1], packet[0]))
    return out


@pytest.mark.parametrize(
    ("effect", "share"),
    [("dropped_fraction", lambda out: 1 - len(out) / 400), ("duplicated_fraction", lambda out: len(out) / 400 - 1)],
)
def test_a_share_is_lost_or_doubled_and_the_seed_says_which(effect: str, share: object) -> None:
    out = carried(kinds.FrameStream(at_s=0.0, **{effect: 0.3}))
    assert 0.22 < share(out) < 0.38  # type: ignore[operator]
    assert out == carried(kinds.FrameStream(at_s=0.0, **{effect: 0.3}))
    assert out != carried(kinds.FrameStream(at_s=0.0, **{effect: 0.3}), seed=2)
    assert all(b - a >= -2 for a, b in itertools.pairwise(n for n, _ in out)), "a copy comes just after the packet behind it"


def test_overtaken_packets_come_after_the_next_one_that_is_not() -> None:
    numbers = [n for n, _ in carried(kinds.FrameStream(at_s=0.0, reordered_fraction=0.3))]
    assert sorted(numbers) == list(range(len(numbers)))
    backward = np.diff(numbers) < 0
    assert 0.15 < backward.mean() < 0.35


@given(st.lists(st.tuples(st.floats(0, 0.5), st.floats(0, 0.99), st.floats(0, 1)), max_size=3), st.integers(0, 50))
def test_nothing_is_made_up_and_nothing_is_late_for_ever(effects: list[tuple[float, float, float]], seed: int) -> None:
    faults = [
        kinds.FrameStream(at_s=0.1, for_s=0.3, delay_s=late + 0.001, dropped_fraction=lost, reordered_fraction=behind)
        for late, lost, behind in effects
    ]
    numbers = [n for n, _ in carried(*faults, seed=seed, packets=100)]
    assert len(set(numbers)) == len(numbers)
    assert set(range(50, 100)) <= set(numbers)


def test_late_samples_arrive_late_and_keep_their_stamps() -> None:
    _, seen = fly_calm(kinds.NavdataStream(at_s=0.5, delay_s=0.3))
    delays = np.array([s.stamp.delay_s for s in seen.samples if isinstance(s, Imu)])
    assert delays[0] == pytest.approx(0.004, abs=0.001)
    assert delays[-1] == pytest.approx(0.304, abs=0.006)
    gap = np.diff([s.stamp.received_at for s in seen.samples if isinstance(s, Imu)]).max() * 1e-9
    assert gap == pytest.approx(0.305, abs=0.006)


def test_doubled_and_overtaken_samples_reach_the_service_once_and_in_order() -> None:
    _, all_of_them = fly_calm(kinds.NavdataStream(at_s=9.0, delay_s=0.1), 0.6)
    for effect in ("duplicated_fraction", "reordered_fraction"):
        _, seen = fly_calm(kinds.NavdataStream(at_s=0.1, **{effect: 0.4}), 0.6)
        stamps = [s.stamp.measured_at for s in seen.samples if isinstance(s, Imu)]
        assert stamps == sorted(set(stamps))
        expected = len([s for s in all_of_them.samples if isinstance(s, Imu)])
        assert len(stamps) == expected if effect == "duplicated_fraction" else len(stamps) < 0.85 * expected


def test_late_commands_move_the_drone_later_and_lost_ones_let_it_go_on() -> None:
    taken = []
    for fault in (kinds.CommandStream(at_s=9.0, delay_s=0.1), kinds.CommandStream(at_s=0.2, delay_s=0.1)):
        flight, _ = fly_calm(fault, 0.25)
        taken.append(flight._drone.state.counters["at_taken"])
    assert taken[1] < taken[0]
    flight, _ = fly_calm(kinds.CommandStream(at_s=0.3, dropped_fraction=1.0), 3.0)
    assert flight._drone.state.silent, "the drone misses its client"


def test_a_datagram_that_was_overtaken_is_old_and_a_restarted_drone_is_not() -> None:
    order = NavdataOrder()
    places = [order.place(n) for n in (5, 6, 9, 8, 9, 10, 1)]
    assert places == [P.NEXT, P.NEXT, P.NEXT, P.OLD, P.OLD, P.NEXT, P.RESTARTED]
    order.silence()
    assert [order.place(n) for n in (40, 30)] == [P.NEXT, P.OLD]


def frame(*faults: Fault, seconds: float = 0.3) -> RenderedFrame:
    return at(World(msgspec.structs.replace(CALM, faults=faults), 1), seconds).render()


def changed(fault: kinds.PictureFault, least: int = 12) -> tuple[float, float, float]:
    """Return the fraction of pixels that a fault changes, and their middle right of and below the pad's centre, in radii."""
    one, other = frame(fault).px, frame().px
    v, u = np.nonzero(np.abs(one.astype(int) - other).max(axis=-1) > least)
    camera = World(CALM, 1).camera
    radius_px = 0.39 * camera.fx / 3.0
    cu, cv = pad_middle(other)
    return len(u) / one[..., 0].size, (float(u.mean()) - cu) / radius_px, (float(v.mean()) - cv) / radius_px


def green(px: NDArray[np.uint8]) -> NDArray[np.bool_]:
    b, g, r = (px[..., i].astype(int) for i in range(3))
    return (g > 50) & (g > 2 * b) & (g > 2 * r)


def pad_middle(px: NDArray[np.uint8]) -> tuple[float, float]:
    v, u = np.nonzero(green(px))
    return float(u.mean()), float(v.mean())


def test_half_of_the_pad_is_hidden_on_the_side_that_it_says() -> None:
    whole = frame().px
    for side, right in ((90.0, True), (-90.0, False)):
        left = green(frame(kinds.PadCovered(at_s=0.1, fraction=0.5, from_deg=side)).px)
        assert left.sum() == pytest.approx(0.5 * green(whole).sum(), rel=0.1)
        assert bool(np.nonzero(left)[1].mean() < pad_middle(whole)[0]) is right


@pytest.mark.parametrize(
    ("fault", "right", "down", "share"),
    [
        (kinds.ObjectOnPad(at_s=0.1, right_m=0.78, size_m=0.5), 2.0, 0.0, (0.001, 0.03)),
        (kinds.ObjectOnPad(at_s=0.1, thing="lifebuoy", forward_m=0.78, size_m=0.5), 0.0, -2.0, (0.001, 0.03)),
        (kinds.ObjectOnPad(at_s=0.1, thing="crate", brightness=0.9, right_m=0.39, size_m=0.3), 1.0, 0.0, (0.001, 0.03)),
        (kinds.ObjectOnPad(at_s=0.1, thing="wet patch", forward_m=-0.78, size_m=0.4), 0.0, 2.0, (0.001, 0.03)),
        (kinds.Bystander(at_s=0.1, thing="box", right_m=0.78, width_m=0.4, height_m=0.1), 2.0, 0.0, (0.001, 0.03)),
        (kinds.OtherPad(at_s=0.1, forward_m=1.17), 0.0, -3.0, (0.01, 0.06)),
        (kinds.Glint(at_s=0.1, forward_m=0.0, right_m=0.39), 1.0, 0.0, (0.005, 0.1)),
    ],
)
def test_things_lie_where_they_say(fault: kinds.PictureFault, right: float, down: float, share: tuple[float, float]) -> None:
    part, u, v = changed(fault)
    assert share[0] < part < share[1]
    assert (u, v) == pytest.approx((right, down), abs=0.2)
    assert np.array_equal(frame(fault, seconds=0.08).px, frame(seconds=0.08).px), "nothing before it begins"


def test_a_pad_in_the_place_of_the_right_one_is_no_true_sight() -> None:
    odd = from_mapping({"title": "x", "faults": [{"kind": "other_pad", "at_s": 1, "instead": True, "file": "theses"}]}, "my.toml")
    with pytest.raises(BadInput, match=r"faults\[0\].file: .*did you mean 'thesis'"):
        pad_model(odd)
    wrong = frame(kinds.OtherPad(at_s=0.1, instead=True, size=0.5))
    assert not wrong.true_view
    assert frame(kinds.OtherPad(at_s=0.1, forward_m=1.2)).true_view
    assert green(wrong.px).sum() == pytest.approx(0.25 * green(frame().px).sum(), rel=0.15)


def test_less_light_is_darker_and_noisier_and_a_lens_blurs_and_zooms() -> None:
    bright, dark = frame().px.astype(float), frame(kinds.LightFalls(at_s=0.1, fraction=0.1)).px.astype(float)
    assert 0.25 < dark.mean() / bright.mean() < 0.4, "a tenth of the light is a third of the value"
    deck = np.s_[100:140, 380:420]
    assert dark[deck].std() / dark[deck].mean() > 1.5 * bright[deck].std() / bright[deck].mean()
    sharp, wet = (
        np.abs(np.diff(px.astype(float), axis=1)).mean() for px in (frame().px, frame(kinds.WetLens(at_s=0.1, drops=80)).px)
    )
    assert wet < 0.85 * sharp
    assert np.array_equal(frame(kinds.WetLens(at_s=0.1)).px, frame(kinds.WetLens(at_s=0.1)).px)
    assert green(frame(kinds.FocalLength(at_s=0.1, scale=1.2)).px).sum() == pytest.approx(
        1.44 * green(frame().px).sum(), rel=0.03
    )


def test_what_acts_without_a_rendered_frame_acts_there_too() -> None:
    clear, covered = (fly_for(1.6, CALM, level="truth", faults=f) for f in ((), (kinds.PadCovered(at_s=0.4, fraction=1.0),)))
    assert clear.health.frames[Verdict.NO_PAD] < 5 < covered.health.frames[Verdict.NO_PAD]
    dark = fly_for(1.6, CALM, level="truth", faults=(kinds.LightFalls(at_s=0.0, fraction=0.0005),))
    scene = next(reversed(dark._perception.scenes._scenes.values()))  # type: ignore[attr-defined]
    assert scene.light_stops == pytest.approx(np.log2(0.0005))
    heights = []
    for faults in ((), (kinds.FocalLength(at_s=0.0, scale=1.1),)):
        flight = fly_for(1.6, CALM, level="model", faults=faults)
        belief = flight.pilot.estimator.at(flight._clock.t)
        heights.append(belief.height_m / float(flight.world.truth().d_body_pad_level[2]))
    assert heights[1] / heights[0] == pytest.approx(1.0 / 1.1, rel=0.03)


@pytest.mark.parametrize("kind", sorted(kinds.PictureFault.__subclasses__(), key=str))
def test_a_level_that_cannot_show_a_picture_refuses_it_by_name(kind: type[kinds.PictureFault]) -> None:
    fault = kind(at_s=1.0, **({"instead": True} if kind is kinds.OtherPad else {}))
    if kind in (kinds.PadCovered, kinds.LightFalls, kinds.FocalLength):
        perceive("model").refuse([fault])
    else:
        with pytest.raises(BadInput, match=f"the fault {fault.kind} is seen in rendered frames only; use --perception pixels"):
            perceive("model").refuse([fault])
    perceive("pixels").refuse([fault])


@pytest.mark.parametrize(("thing", "right_m", "unsafe"), [("crate", 0.2, 1), ("crate", 0.6, 0), ("wet patch", 0.0, 0)])
def test_a_contact_with_a_thing_is_unsafe_and_one_with_water_is_not(thing: str, right_m: float, unsafe: int) -> None:
    lies = {"kind": "object_on_pad", "at_s": 0.0, "thing": thing, "size_m": 0.3, "right_m": right_m}
    scenario = from_mapping({"title": "x", "start": {"height_m": 0.6}, "faults": [lies]}, "mine.toml")
    flight = new_flight(scenario)
    flight.world.vehicle.land()
    while flight.world.truth().touchdown is None:
        flight.world.advance(after(flight.world.now, 0.05))
    flight._grader.step()
    met = [line for line in flight.result().as_json()["unsafe"] if line.startswith(f"touched a {thing} on the pad")]
    assert len(met) == unsafe


@pytest.mark.parametrize(("right_m", "height_m", "unsafe"), [(0.1, 1.7, 1), (1.2, 1.7, 0), (0.1, 0.2, 0)])
def test_to_fly_into_a_person_is_unsafe_and_to_fly_beside_or_above_is_not(right_m: float, height_m: float, unsafe: int) -> None:
    stands = {"kind": "bystander", "at_s": 0.0, "right_m": right_m, "height_m": height_m}
    scenario = from_mapping({"title": "x", "start": {"height_m": 1.0, "pad_right_m": 0.0}, "faults": [stands]}, "mine.toml")
    flight = new_flight(scenario)
    flight.world.advance(after(flight.world.now, 0.05))
    for _ in range(2):
        flight._grader.step()
    assert len([line for line in flight.result().as_json()["unsafe"] if line.startswith("flew into a person")]) == unsafe
