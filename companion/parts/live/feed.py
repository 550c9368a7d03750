"""What viewers are shown: events are taken on the flight's loop, encoded on a thread of its own, and dropped when that is behind.

Nothing is taken that no viewer asked for. The messages are those of a recording, by the same encoder.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import msgspec

from companion.base.health import Health
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.base.orders import HandledOrder
from companion.base.worker import Worker
from companion.recording import channels, encode
from companion.recording.message_encoder import MessageEncoder
from companion.settings.live import FoxgloveSettings
from drivers.mailbox import Line
from estimator.contracts.estimates import Verdict
from estimator.contracts.fusion import FusionResult
from estimator.contracts.samples import (
    Attitude,
    Baro,
    BodyVelocity,
    GeoFix,
    GimbalAttitude,
    Imu,
    Range,
    Sample,
    VehicleStatus,
    VesselReport,
)
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad

Encoded = tuple[str, int, bytes]
"""Topic, time on the viewer's axis in ns, and the message as JSON."""
_EVENTS, _FRAMES = 1024, 2
"""Events and frames that may wait for the thread: some two seconds of them, and 1.4 MB."""
_NEVER_LIVE = frozenset({channels.TRUTH, channels.TRUE_POSE, channels.LINK})
"""Topics of the simulator and of links, which are recorded otherwise."""
_SAMPLE_TOPICS: dict[type, frozenset[str]] = {
    Imu: frozenset({"/sample/imu"}),
    Attitude: frozenset({"/sample/attitude", channels.TRANSFORMS}),
    GimbalAttitude: frozenset({"/sample/gimbal"}),
    BodyVelocity: frozenset({"/sample/velocity"}),
    Range: frozenset({"/sample/range"}),
    Baro: frozenset({"/sample/baro"}),
    VesselReport: frozenset({"/sample/vessel"}),
    GeoFix: frozenset({"/sample/fix"}),
    VehicleStatus: frozenset({"/sample/status"}),
}


def topics(settings: FoxgloveSettings) -> tuple[str, ...]:
    """Return the topics that are offered."""
    image = {"jpeg": {channels.IMAGE}, "h264": {channels.VIDEO}, "none": set[str]()}[settings.frames]
    return tuple(t for t in channels.TOPICS if t not in _NEVER_LIVE and (t not in (channels.IMAGE, channels.VIDEO) or t in image))


class LiveFeed(NullObserver):
    """An observer of the flight.

    Args:
        offset_ns: the offset from the monotonic clock to the viewers' time axis, ns.
        send: is given each message that somebody asked for.
    """

    def __init__(
        self,
        settings: FoxgloveSettings,
        camera: Camera,
        pad: Pad,
        offset_ns: int,
        health: Health,
        send: Callable[[Sequence[Encoded]], None],
    ) -> None:
        self._settings = settings
        self._health = health
        self._send = send
        self._encoder = MessageEncoder(camera, offset_ns, settings.frames, settings.jpeg_quality, pad)
        self._json = msgspec.json.Encoder()
        self._events: Line[tuple[MonoNs, object]] = Line(_EVENTS)
        self._wanted: frozenset[str] = frozenset()
        self._again = False
        self._frames_waiting = 0
        self._shown: MonoNs | None = None
        self._reported: MonoNs | None = None
        self._counts: Counter[str] = Counter()

    def counted(self) -> dict[str, float]:
        """Return the counters for health."""
        return {"messages": 0, "frames_dropped": 0, **self._counts, "events_dropped": self._events.dropped}

    def want(self, wanted: frozenset[str], *, new: bool) -> None:
        """Take what these topics need from now on.

        Args:
            new: somebody asked for another topic, and is told again what does not change.
        """
        self._wanted = wanted
        self._again = self._again or new

    def on_sample(self, sample: Sample) -> None:
        if self._wanted and not self._wanted.isdisjoint(_SAMPLE_TOPICS[type(sample)]):
            self._events.offer((sample.stamp.received_at, sample))

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        if channels.fusion(result.source) in self._wanted and (result.source != "imu" or result.verdict is not Verdict.FUSED):
            self._events.offer((at, result))

    def on_frame(self, processed: ProcessedFrame) -> None:
        images = not self._wanted.isdisjoint((channels.IMAGE, channels.VIDEO))
        if not images and self._wanted.isdisjoint((channels.DETECTION, channels.ANNOTATIONS)):
            return
        keep = images and self._due(processed.done)
        if keep and self._frames_waiting >= _FRAMES:
            self._counts["frames_dropped"] += 1
            keep = False
        self._frames_waiting += keep
        self._events.offer((processed.done, (encode.detection(processed), processed if keep else None, processed.detection)))

    def on_decision(self, decision: Decision) -> None:
        if not self._wanted:
            return
        self._events.offer((decision.at, decision))
        if channels.HEALTH in self._wanted and (self._reported is None or seconds_between(self._reported, decision.at) >= 1.0):
            self._reported = decision.at
            self._events.offer((decision.at, encode.health(decision.at, self._health.snapshot())))

    def on_order(self, handled: HandledOrder) -> None:
        if self._wanted:
            self._events.offer((handled.at, handled))

    async def run(self) -> None:
        """Encode and send until cancelled."""
        worker = Worker("foxglove")
        try:
            async for events in self._events.together():
                again, self._again = self._again, False
                # A frame that the queue dropped waits no more either: all that wait are in this batch.
                self._frames_waiting = 0
                encoded = await worker.run(self._encoded, events, self._wanted, again)
                self._counts["messages"] += len(encoded)
                self._send(encoded)
        finally:
            worker.close()

    def _due(self, at: MonoNs) -> bool:
        due = self._shown is None or seconds_between(self._shown, at) >= 0.9 / self._settings.frame_rate_hz
        if due:
            self._shown = at
        return due

    def _encoded(self, events: Sequence[tuple[MonoNs, object]], wanted: frozenset[str], again: bool) -> list[Encoded]:
        """Return the wanted messages of these events; runs on the thread."""
        if again:
            self._encoder.begin()
        out = []
        for at, what in events:
            for topic, t, message in self._encoder.messages(at, what):
                if topic in wanted:
                    out.append((topic, t, self._json.encode(message)))
        return out
