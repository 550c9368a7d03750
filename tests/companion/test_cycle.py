"""One stream of samples and frames through the simulated flight, the daemon and the replay: every output is equal to the bit."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, nullcontext
from unittest.mock import patch

import cv2
import pytest

from companion.cycle.ports import VehicleLink
from companion.facts import encode
from companion.guidance.pilot import make_pilot
from companion.recording.reading import RecordedFrame
from companion.service.daemon import Daemon, DaemonSetup
from companion.settings.model import Settings
from companion.tools.replay.engine import Replay
from drivers.mailbox import Latest, Line
from drivers.reconnect import BackOff
from estimator.contracts.commands import Command
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.time import MonoNs
from sitl.ardrone.flight import Flight
from sitl.flight.stepped import Timing
from sitl.scenario.scenario import Scenario, load
from tests.companion.virtual_flight import VirtualClock, settled
from tests.fly import ObservedCalls, near, sim_settings
from tests.make import same_bits

STEPS = 600


class Stream:
    """The inputs of a simulated flight's cycle, tick by tick, and its outputs. It reads as a recording does."""

    name = "a flight"

    def __init__(self, scenario: Scenario, settings: Settings) -> None:
        self.outputs = ObservedCalls()
        self.ticks: list[tuple[MonoNs, list[Sample], list[Frame], bool]] = []
        flight = Flight(scenario, 3, settings, make_pilot(settings), observers=[self.outputs], timing=Timing(vision_s=0.0))
        seen = self.outputs
        for _ in range(STEPS):
            before = len(seen.samples), len(seen.frames), len(seen.decisions)
            flight.step()
            frames = [each.frame for each in seen.frames[before[1] :]]
            self.ticks.append((flight._clock.t, seen.samples[before[0] :], frames, len(seen.decisions) > before[2]))

    def events(self) -> Iterator[object]:
        frames, decisions = iter(self.outputs.frames), iter(self.outputs.decisions)
        for _, samples, arrived, decided in self.ticks:
            yield from samples
            for _ in arrived:
                processed = next(frames)
                yield RecordedFrame(encode.detection(processed), cv2.imencode(".png", processed.frame.px)[1].tobytes())
            if decided:
                yield next(decisions)


class Link:
    """The vehicle of a stream, as a driver would offer it."""

    def __init__(self) -> None:
        self.frames: Latest[Frame] = Latest()
        self.samples: Line[Sample] = Line(1000)

    def command(self, command: Command) -> None:
        return None

    def release(self) -> None:
        return None

    @asynccontextmanager
    async def open(self) -> AsyncIterator[VehicleLink]:
        yield self


class StreamClock(VirtualClock):
    """Guidance sleeps until the flight's own next cycle."""

    def __init__(self, cycles: list[MonoNs]) -> None:
        super().__init__()
        self.t, self._cycles = MonoNs(cycles[0] - 1), cycles

    async def sleep(self, seconds: float) -> None:
        due = next((t for t in self._cycles if t > self.t), self._cycles[-1] + 1) if 0.015 < seconds < 0.025 else None
        await super().sleep(seconds if due is None else 1e-9 * (due - self.t))


async def by_the_daemon(stream: Stream, settings: Settings) -> ObservedCalls:
    cycles = [t for t, _, _, decided in stream.ticks if decided]
    clock, link, outputs = StreamClock(cycles), Link(), ObservedCalls()
    options = DaemonSetup(BackOff(0.01, 0.01, 5.0, 1.0), settings.guidance.rate_hz)
    daemon = Daemon(link.open, make_pilot(settings), clock, options, observers=[outputs])
    with patch("companion.service.daemon.no_full_collections", nullcontext):
        task = asyncio.create_task(daemon.run())
        for at, samples, frames, _ in stream.ticks:
            for sample in samples:
                link.samples.offer(sample)
            clock.t = at
            for frame in frames:
                link.frames.offer(frame)
            await settled()
            while daemon.looking:  # noqa: ASYNC110 (the thread of vision)
                await asyncio.sleep(0)
            await clock.pass_to(at)
        daemon.stop()
        task.cancel()
        await asyncio.wait({task})
    return outputs


def by_replay(stream: Stream, settings: Settings) -> ObservedCalls:
    outputs = ObservedCalls()
    Replay(stream, make_pilot(settings), observers=[outputs]).run()  # type: ignore[arg-type]
    return outputs


@pytest.mark.parametrize("scenario", [near(), load("weather_3")], ids=["near", "weather_3"])
def test_flight_daemon_and_replay_make_the_same_of_one_stream(scenario: Scenario) -> None:
    settings = sim_settings()
    stream = Stream(scenario, settings)
    flown = stream.outputs
    assert len(flown.frames) > 20
    assert len(flown.decisions) > 100
    for outputs in (asyncio.run(by_the_daemon(stream, settings)), by_replay(stream, settings)):
        for name in ("samples", "results", "decisions"):
            theirs, ours = getattr(outputs, name), getattr(flown, name)
            assert len(theirs) == len(ours), name
            for n, (a, b) in enumerate(zip(theirs, ours, strict=True)):
                assert same_bits(a, b), (name, n, a, b)
        for a, b in zip(outputs.frames, flown.frames, strict=True):
            assert a.verdict is b.verdict
            for seen in () if b.detection is None else ("selected", "elsewhere", "on_pad"):
                assert same_bits(getattr(a.detection, seen), getattr(b.detection, seen)), seen
