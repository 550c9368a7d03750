"""The service over a fake vehicle: every frame counted once, a lost link back alone, a bug loud, and always a hover left."""

import asyncio
import itertools
import logging
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any, cast

import numpy as np
import pytest
from msgspec import structs

from companion.base.health import Health
from companion.base.mission import FlightOutcome
from companion.base.observer import Decision, NullObserver
from companion.base.orders import OperatorOrder
from companion.cycle.ports import Assembly, VehicleLink
from companion.facts import encode
from companion.guidance.pilot import Look, Pilot, make_pilot
from companion.recording.decode import frame_times
from companion.service.daemon import Daemon, DaemonSetup
from companion.service.vehicle_parts import ExposurePart, vehicle_parts
from companion.settings.guidance import GuidanceOptions
from companion.settings.load import camera_model, from_mapping, load, pad_model
from companion.settings.model import CameraSettings
from drivers.camera.exposure import ExposureDrive, ExposureRange, ExposureSetting
from drivers.camera.metering import TARGET
from drivers.camera.options import ExposureOptions
from drivers.clock import SystemClock
from drivers.mailbox import Latest, Line
from drivers.reconnect import BackOff
from estimator.contracts.commands import Command, CutMotors, Hover
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import FusionResult, RelativeState, Verdict
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.time import MonoNs, after, seconds_between
from estimator.options import EstimatorOptions
from estimator.vision.camera.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.options import TrackerOptions
from estimator.vision.pad.pad import Pad
from estimator.vision.track.config import TrackerConfig
from tests.fly import ObservedCalls
from tests.make import attitude, estimate, imu, processed_frame, stamp_at, status
from tests.support.clocks import PatientClock
from tests.support.toy_autopilot import PAGE
from tests.support.waiting import until

SIM = load("sim")
EYES = TrackerConfig(camera_model(SIM), pad_model(SIM), TrackerOptions(colours="simulator"))
CLOCK = PatientClock()
SEA = np.full((360, 640, 3), (90, 60, 20), np.uint8)


class FakeVehicle:
    """Driver as the daemon sees it, with a record of the daemon's calls."""

    def __init__(self) -> None:
        self.frames: Latest[Frame] = Latest()
        self.samples: Line[Sample] = Line(1000)
        self.commands: list[Command] = []
        self.released = False
        self.opened = 0
        self.left_hovering = 0

    def command(self, command: Command) -> None:
        self.commands.append(command)

    def release(self) -> None:
        self.released = True

    @asynccontextmanager
    async def open(self) -> AsyncIterator[VehicleLink]:
        self.opened += 1
        self.frames, self.samples = Latest(), Line(1000)
        try:
            yield self
        finally:
            self.left_hovering += 1

    def say(self, *, flying: bool) -> None:
        stamp = stamp_at(CLOCK.now())
        self.samples.offer(status(stamp, flying, "hovering" if flying else "landed"))
        self.samples.offer(attitude(stamp, var=1e-5))

    def film(self, seq: int, px: np.ndarray = SEA, late_s: float = 0.02) -> None:
        now = CLOCK.now()
        px = px.copy()
        px[:, 0] = seq  # no two frames of a camera are alike
        self.frames.offer(Frame(stamp_at(after(now, -late_s), now), seq, px))


def daemon_of(
    open_link: Callable[[], AbstractAsyncContextManager[VehicleLink]],
    diary: NullObserver | None = None,
    *,
    pilot: Pilot | None = None,
    **setup: Any,
) -> Daemon:
    pilot = pilot or Pilot(EYES, EstimatorOptions(), GuidanceOptions())
    observers = [] if diary is None else [diary]
    return Daemon(open_link, pilot, CLOCK, DaemonSetup(BackOff(0.01, 0.01, 5.0, 1.0), 50.0, **setup), observers=observers)


@asynccontextmanager
async def running(daemon: Daemon, vehicle: FakeVehicle) -> AsyncIterator[None]:
    """Run a daemon from when the vehicle is open until the context ends."""
    async with asyncio.TaskGroup() as group:
        group.create_task(daemon.run())
        await until(lambda: vehicle.opened == 1)
        yield
        daemon.stop()


@pytest.mark.hazard("H5", "H11")
@pytest.mark.parametrize(("part", "counted"), [
    ("estimator.all_at", "guidance"), ("landing.command", "guidance"), ("estimator.put", "estimator"),
    ("estimator.admit", "vision"),
])  # fmt: skip
async def test_a_fault_of_ours_never_holds_back_a_cut_a_hold_or_an_abort(part: str, counted: str) -> None:
    vehicle, diary = FakeVehicle(), ObservedCalls()
    daemon = daemon_of(vehicle.open, diary)
    pilot, (owner, name) = daemon._pilot, part.split(".")
    sequence = itertools.cycle(range(1, 250))

    async def obeyed(order: OperatorOrder, wanted: type[Command], *, fails: bool = True) -> None:
        """Give an order, and wait until nothing but the command for it is sent, and the fault was met."""
        assert pilot.operator.take(order, PAGE, CLOCK.now()).accepted
        began = len(vehicle.commands)

        def goes_on() -> bool:
            vehicle.say(flying=True)
            vehicle.film(next(sequence))
            return len(vehicle.commands) > began + 10 and (not fails or daemon.health.contained[counted] > 0)

        await until(goes_on)
        assert all(isinstance(command, wanted) for command in vehicle.commands[began + 1 :])

    async with running(daemon, vehicle):
        vehicle.say(flying=True)
        vehicle.film(0)
        await until(lambda: len(vehicle.commands) > 5)
        await obeyed(OperatorOrder.HOLD, Hover, fails=False)
        setattr(getattr(pilot, owner), name, fail)
        await obeyed(OperatorOrder.ABORT, Hover)
        if counted == "guidance":
            assert "guidance failed, and the order is obeyed without it: broken" in diary.decisions[-1].reason
        await obeyed(OperatorOrder.EMERGENCY, CutMotors)


def fail(*_: object, **__: object) -> Any:
    raise ZeroDivisionError("broken")


async def test_every_frame_offered_ends_in_exactly_one_verdict() -> None:
    vehicle, diary = FakeVehicle(), ObservedCalls()
    daemon = daemon_of(vehicle.open, diary)
    async with running(daemon, vehicle):
        vehicle.film(0)
        await until(lambda: daemon.health.frames[Verdict.NO_ATTITUDE] == 1)
        vehicle.say(flying=True)
        vehicle.film(1, np.zeros((20, 20, 3), np.uint8))
        await until(lambda: daemon.health.frames[Verdict.FAILED] == 1)
        for seq in range(2, 60):
            vehicle.say(flying=True)
            vehicle.film(seq)
            if seq % 3:
                await asyncio.sleep(0.01)
        await until(lambda: daemon.health.frames.total() == vehicle.frames.offered)
    assert vehicle.frames.offered == 60
    assert daemon.health.frames.total() == 60
    assert daemon.health.frames[Verdict.REPLACED] == vehicle.frames.replaced > 0
    assert daemon.health.frames[Verdict.NO_PAD] > 0
    assert len(diary.frames) == 60 - vehicle.frames.replaced
    for processed in diary.frames:
        whole_s, times = seconds_between(processed.frame.stamp.received_at, processed.done), processed.times
        assert (times is None) == (processed.detection is None)
        if times is not None:
            parts_s = [seconds for _, seconds in times.by_stage()]
            assert min(parts_s) >= 0.0
            assert sum(parts_s) == pytest.approx(whole_s)
            assert frame_times(encode.detection(processed)) == times
    looks = sum(processed.times is not None for processed in diary.frames)
    assert {name: daemon.health.delays[name].count for name in ("decode", "wait", "look", "filter")} == dict.fromkeys(
        ("decode", "wait", "look", "filter"), looks
    )
    assert daemon.health.delays["decide"].count == len(diary.decisions)
    assert 0 < daemon.health.delays["send"].count <= len(diary.decisions)


async def test_a_frame_waits_for_an_attitude_that_is_still_in_a_socket() -> None:
    vehicle, diary = FakeVehicle(), ObservedCalls()
    daemon = daemon_of(vehicle.open, diary)
    async with running(daemon, vehicle):
        vehicle.say(flying=True)
        await asyncio.sleep(0.1)
        vehicle.film(1, late_s=0.0)  # its exposure lies beyond what the newest attitude reaches, and no sample is queued
        await asyncio.sleep(0.01)
        vehicle.say(flying=True)
        await until(lambda: daemon.health.frames.total() == 1)
    assert daemon.health.frames == {Verdict.NO_PAD: 1}


class CountingPilot(Pilot):
    """A pilot that counts how often it is given samples, and notes how many wait while it decides."""

    vehicle_link: FakeVehicle
    given = 0

    def on_samples(self, samples: Sequence[Sample], *, wanted: bool = True) -> list[tuple[FusionResult, ...]]:
        self.given += 1
        return super().on_samples(samples, wanted=wanted)

    def decide(self, now: MonoNs) -> Decision:
        self.waiting = max(getattr(self, "waiting", 0), len(self.vehicle_link.samples))
        return super().decide(now)


async def test_samples_are_taken_together_and_none_waits_while_guidance_decides() -> None:
    vehicle, diary = FakeVehicle(), ObservedCalls()
    pilot = CountingPilot(EYES, EstimatorOptions(), GuidanceOptions())
    pilot.vehicle_link = vehicle
    daemon = daemon_of(vehicle.open, diary, pilot=pilot)
    async with running(daemon, vehicle):
        for _ in range(200):
            vehicle.say(flying=True)
            await asyncio.sleep(0)
        decided = len(diary.decisions)
        await until(lambda: len(diary.decisions) >= decided + 2)
    assert daemon.health.flows["Attitude"].count == 200
    assert pilot.given <= 3 + 2 * len(diary.decisions), "or the loop wakes for each datagram"
    assert pilot.given < 100
    assert pilot.waiting == 0


@pytest.mark.parametrize("diary", [None, ObservedCalls()])
async def test_every_result_of_a_sample_is_in_the_health_that_is_read(diary: ObservedCalls | None) -> None:
    vehicle = FakeVehicle()
    daemon = daemon_of(vehicle.open, diary)
    async with running(daemon, vehicle):
        for n in (70, 140, 210):
            for _ in range(70):
                vehicle.say(flying=True)
                await asyncio.sleep(0)
            counted = daemon.health.flows["Decision"].count
            await until(lambda counted=counted: daemon.health.flows["Decision"].count >= counted + 2)
            if diary is not None:
                assert len(diary.results) == n
            output = daemon.health.snapshot()
            assert sum(output.inputs["Attitude"].values()) == n
            assert [sum(one.verdicts.values()) for one in output.fusion] == [n]
    assert diary is None or diary.results == sorted(diary.results, key=lambda one: one[0])


async def test_a_slow_machine_leaves_frames_out_and_counts_them(monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle, detect = FakeVehicle(), Pilot.detect

    def slow(pilot: Pilot, look: Look) -> Detection:
        time.sleep(0.05)
        return detect(pilot, look)

    monkeypatch.setattr(Pilot, "detect", slow)
    daemon = daemon_of(vehicle.open, core_fraction=0.4)
    async with running(daemon, vehicle):
        for seq in range(1, 60):
            vehicle.say(flying=True)
            vehicle.film(seq)
            await asyncio.sleep(0.01)
        await until(lambda: daemon.health.frames.total() == vehicle.frames.offered)
    frames = daemon.health.frames
    assert frames[Verdict.SKIPPED] > frames[Verdict.NO_PAD] > 0
    assert frames.total() == 59


async def test_a_lost_vehicle_comes_back_alone_while_guidance_goes_on() -> None:
    vehicle, diary = FakeVehicle(), ObservedCalls()
    daemon = daemon_of(vehicle.open, diary)
    async with running(daemon, vehicle):
        vehicle.samples.fail(Recoverable("unplugged"))
        await until(lambda: vehicle.opened == 2)
        rounds = len(diary.decisions)
        vehicle.say(flying=True)
        await until(lambda: len(diary.decisions) > rounds + 3 and Hover() in vehicle.commands)
        assert not vehicle.released, "one that is opened again holds the drone meanwhile"
    assert vehicle.released
    assert daemon.health.parts["vehicle"].restarts == 1
    assert daemon.health.parts["vehicle"].last_error == "unplugged"
    assert daemon.health.parts["guidance"].restarts == 0


async def test_a_bug_of_ours_is_loud_and_leaves_the_vehicle_in_its_hover(monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle = FakeVehicle()
    daemon = daemon_of(vehicle.open)

    def broken(*_: object) -> None:
        raise ZeroDivisionError("ours")

    monkeypatch.setattr(Pilot, "detect", broken)

    async def feed() -> None:
        await until(lambda: vehicle.opened == 1)
        vehicle.say(flying=True)
        for seq in range(1, 200):  # a busy machine may not be ready for the first
            await asyncio.sleep(0.05)
            vehicle.film(seq)

    async def both() -> None:
        async with asyncio.timeout(60), asyncio.TaskGroup() as group:
            group.create_task(feed())
            await daemon.run()

    with pytest.raises(ExceptionGroup) as caught:
        await both()
    assert caught.value.subgroup(ZeroDivisionError) is not None
    assert vehicle.left_hovering == 1


async def test_it_ends_with_the_flight_when_ordered_or_when_it_is_cancelled_and_closes_the_vehicle() -> None:
    vehicle = FakeVehicle()

    async def feed() -> None:
        await until(lambda: vehicle.opened == 1)
        vehicle.say(flying=True)
        await until(lambda: bool(vehicle.commands))
        vehicle.say(flying=False)

    async with asyncio.timeout(60):
        outcome, _ = await asyncio.gather(daemon_of(vehicle.open, once=True).run(), feed())
    assert (outcome, vehicle.left_hovering) == (FlightOutcome.LANDED_BY_OTHERS, 1)
    task = asyncio.ensure_future(daemon_of(vehicle.open).run())
    await until(lambda: vehicle.opened == 2)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert vehicle.left_hovering == 2


SETTINGS = from_mapping(
    {
        "vehicle": {"kind": "mavlink", "links": "udpin://127.0.0.1:0"},
        "camera": {"file": "sim", "source": "v4l2", "device": "Test camera", "exposure": {"mode": "pad"}},
        "pad": {"file": "thesis"},
    },
    "test",
)
PILOT = make_pilot(SETTINGS)
HEIGHT_M, AHEAD_M = 3.0, 0.6
PERIOD_NS = 33_333_333


class BelievingPilot:
    """Believes that the pad is ahead of the vehicle, or nothing."""

    def __init__(self, tracked: bool) -> None:
        self.tracked = tracked
        self.camera: Camera = PILOT.camera
        self.pad: Pad = PILOT.pad
        self.estimator = self

    def at(self, now: MonoNs) -> RelativeState | None:
        if not self.tracked:
            return None
        return estimate(now * 1e-9, (AHEAD_M, 0.0, HEIGHT_M), sigma=1.0)


class Scene:
    """A pad in the middle of the upper half of the frame, and a sea that is ten times as bright."""

    def __init__(self, white_per_ms: float, tracked: bool = True) -> None:
        self.white_per_ms, self.number = white_per_ms, 0
        self.drive = ExposureDrive(settle_frames=1)
        self.drive.opened(ExposureRange(1e-4, 0.026, 8.0), ExposureSetting(0.008, 1.0))
        self.part = ExposurePart(ExposureOptions(mode="pad"), cast("Pilot", BelievingPilot(tracked)))
        self.part.attach(self.drive)
        camera = PILOT.camera
        v, u = np.mgrid[: camera.height, : camera.width]
        pad_v = camera.cy - camera.fy * (AHEAD_M - camera.T_body_cam.t[0]) / HEIGHT_M
        self.inside = np.hypot(u - camera.cx, v - pad_v) < 1.1 * camera.fx * PILOT.pad.disc_radius_m / HEIGHT_M

    def run(self, frames: int, w_body: float = 0.0) -> ExposureSetting:
        for _ in range(frames):
            held = self.drive.held
            self.number += 1
            stamp = stamp_at(self.number * PERIOD_NS)
            self.part.on_sample(imu(stamp, (0.0, w_body, 0.0)))
            white = self.white_per_ms * 1e3 * held.product_s
            light = np.where(self.inside, white, 10.0 * white)
            grey = np.round(255.0 * np.clip(light, 0.0, 1.0) ** (1 / 2.2)).astype(np.uint8)
            frame = Frame(stamp, self.number, np.repeat(grey[..., None], 3, axis=2), held.exposure_s, held.gain)
            self.part.on_frame(processed_frame(frame, own=attitude(stamp)))
            if (wanted := self.drive.take()) is not None:
                self.drive.changed(wanted, self.number, self.number)
        assert self.drive.held is not None
        return self.drive.held


def test_the_pad_is_metered_and_not_the_bright_sea_around_it() -> None:
    scene = Scene(0.2)
    held = scene.run(60)
    assert scene.white_per_ms * 1e3 * held.product_s == pytest.approx(TARGET, rel=0.25)
    counted = scene.part.counted()
    assert (counted["frames_pad"], counted["frames_search"], counted["frames_dark"]) == (60, 0, 0)
    assert (counted["exposure_ms"], counted["gain"]) == (round(1e3 * held.exposure_s, 3), round(held.gain, 2))


def test_without_a_belief_the_whole_picture_is_metered() -> None:
    scene = Scene(0.2, tracked=False)
    scene.run(60)
    assert scene.part.counted()["frames_search"] == 60


def test_a_vehicle_that_turns_gets_short_exposures_and_gain_in_their_place() -> None:
    scene = Scene(0.05)
    still = scene.run(60)
    turning = scene.run(30, w_body=0.8)
    assert turning.exposure_s * PILOT.camera.fx * 0.8 <= 1.5 < still.exposure_s * PILOT.camera.fx * 0.8
    assert turning.product_s == pytest.approx(still.product_s, rel=0.05)
    assert scene.run(200).exposure_s > 1.8 * turning.exposure_s


def test_a_pad_too_dark_for_the_camera_is_counted_and_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    scene = Scene(1e-4)
    scene.run(300)
    assert scene.part.counted()["frames_dark"] > 200
    assert caplog.text.count("stops too dark at 20.0 ms and gain 8.0, which the motion and the camera limit") == 1
    scene.white_per_ms = 0.2
    scene.run(60)
    assert caplog.text.count("the pad is rightly exposed again") == 1


def test_the_service_has_the_part_where_the_settings_ask_for_it() -> None:
    own = structs.replace(SETTINGS, camera=CameraSettings("sim", source="v4l2", device="Test camera"))
    for settings, there in ((SETTINGS, True), (own, False)):
        health = Health(SystemClock())
        parts: Any = vehicle_parts(Assembly(settings, PILOT, health, SystemClock()))
        assert any(isinstance(observer, ExposurePart) for observer in parts.observers) is there
        assert ("exposure" in health.snapshot().counters) is there
