"""The gimbal that carries the camera, on an autopilot's links: take its reports, request them, and point it down.

async with tending(Gimbal(options, clock), autopilot): ...    # its attitudes are among `autopilot.samples`
"""

import math
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from drivers.mavlink.access import AccessLevel, Source
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.dialect import Message
from drivers.mavlink.gimbal_pointer import GimbalPointer
from drivers.mavlink.gimbal_reports import DEVICE_STATUS, MOUNT_ORIENTATION, MOUNT_STATUS, GimbalSampler
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.options import GimbalOptions
from drivers.mavlink.requests import Streams, is_for
from drivers.reconnect import Repeated, running_beside
from estimator.contracts.samples import GimbalAttitude
from estimator.contracts.time import Clock, MonoNs, seconds_between

_TICK_S = 0.1  # interval at which requests and commands are checked
_SILENT_S = 3.0
"""Time of silence after which the gimbal may report over another link or from another peer."""


_REPORTS = frozenset({DEVICE_STATUS, MOUNT_ORIENTATION, MOUNT_STATUS})
_MANAGER = frozenset({"GIMBAL_MANAGER_STATUS", "GIMBAL_MANAGER_INFORMATION"})


class Gimbal:
    """One gimbal; see the module's docstring.

    Its reports count only from the vehicle's own system and from the first place that they come from: like an autopilot's ids, a
    gimbal's prove nothing.
    """

    def __init__(self, options: GimbalOptions, clock: Clock) -> None:
        self._o = options
        self._clock = clock
        self.sampler = GimbalSampler(options)
        self.pointer = GimbalPointer(options.device_id) if options.point_down else None
        self._streams = Streams({MOUNT_STATUS if options.report == "mount_status" else DEVICE_STATUS: options.rate_hz})
        self._heard: tuple[Source, int] | None = None
        self._heard_at: MonoNs | None = None
        self._manager: tuple[int, int] | None = None
        self._connects = 0
        self._samples = 0
        self._times: deque[MonoNs] = deque(maxlen=50)
        """Time when the newest of them were received."""

    @property
    def device_id(self) -> int:
        return self._o.device_id

    @property
    def rate_hz(self) -> float:
        """The rate of its newest reports that were taken, Hz; 0 while none come."""
        times = self._times
        if len(times) < 2 or seconds_between(times[-1], self._clock.now()) > 1.0:
            return 0.0
        return (len(times) - 1) / max(seconds_between(times[0], times[-1]), 1e-3)

    def counted(self) -> dict[str, float]:
        """Return the counters for health."""
        out: dict[str, float] = {"reports": self._samples}
        out |= {f"refused_{why}": n for why, n in self.sampler.refused.items()}
        if self.pointer is not None:
            out |= {name: self.pointer.counts[name] for name in ("pointed", "left")}
            out["pointing_refused"] = self.pointer.counts["refused"]
        return out

    def _on_ack(self, received: ReceivedMessage, autopilot: tuple[int, int]) -> None:
        sender = (received.system, received.component)
        if sender == self._device(autopilot):
            self._streams.on_message(received.message, received.received_at)
        if self.pointer is not None and sender == (self._manager or autopilot):
            self.pointer.on_ack(int(received.message.command), int(received.message.result), received.received_at)

    def on_message(self, autopilot: Autopilot, received: ReceivedMessage) -> GimbalAttitude | None:
        """Take any message of the autopilot's links; return the sample of a report."""
        identity, kind, m = autopilot.identity, received.message.get_type(), received.message
        if identity is None or received.system != identity.system or received.access_level < AccessLevel.PEER:
            return None
        if kind in _MANAGER:
            if m.gimbal_device_id == self._o.device_id:
                self._manager = (received.system, received.component)
            return None
        if kind == "COMMAND_ACK":
            if is_for(m, autopilot.links.identity):
                self._on_ack(received, identity.address)
            return None
        own = received.component == identity.component
        if kind not in _REPORTS or not self._reports(m, received.component, own=own) or not self._hold(received):
            return None
        self._streams.on_message(m, received.received_at)
        sample = self.sampler.sample(m, received.received_at, autopilot.boot_clock if own else None)
        if sample is not None:
            self._samples += 1
            self._times.append(received.received_at)
        return sample

    def due(self, autopilot: Autopilot, now: MonoNs) -> list[Message]:
        """Return the messages to send now."""
        identity, streams = autopilot.identity, autopilot.streams
        if identity is None or streams is None or not autopilot.connected:
            return []
        if autopilot.connects != self._connects:
            self._connects = autopilot.connects
            self._streams.restart()
            self.sampler.restart()
            if self.pointer is not None:
                self.pointer.restart()
        out: list[Message] = []
        # An answer does not name the stream that it is for, so the request goes out when the autopilot has answered all others.
        if streams.settled or not self._o.of_autopilot:
            out += self._streams.due(now, self._device(identity.address))
        if self.pointer is not None:
            out += self.pointer.due(now, autopilot.links.identity, self._manager or identity.address, self._off_rad())
        return out

    def _device(self, autopilot: tuple[int, int]) -> tuple[int, int]:
        return autopilot if self._o.of_autopilot else (autopilot[0], self._o.device_id)

    def _reports(self, m: Message, component: int, *, own: bool) -> bool:
        """Return whether a report is one of this gimbal; older autopilots do not number theirs."""
        if m.get_type() != DEVICE_STATUS:
            return own or component == self._o.device_id
        if self._o.of_autopilot:
            return own and m.gimbal_device_id in ((0, 1) if self._o.device_id == 1 else (self._o.device_id,))
        return bool(component == self._o.device_id)

    def _hold(self, received: ReceivedMessage) -> bool:
        """Return whether a report comes from where the gimbal's reports come from."""
        came_from, at = (received.source, received.component), received.received_at
        silent = self._heard_at is None or seconds_between(self._heard_at, at) > _SILENT_S
        if self._heard != came_from:
            if not silent:
                return False
            self._heard = came_from
            self.sampler.restart()
        self._heard_at = at
        return True

    def _off_rad(self) -> float | None:
        newest = self.sampler.newest
        if newest is None:
            return None
        return math.acos(max(-1.0, min(1.0, float(newest.R_frame_gimbal.matrix[2, 0]))))


@asynccontextmanager
async def tending(gimbal: Gimbal | None, autopilot: Autopilot, clock: Clock) -> AsyncIterator[None]:
    """Run the gimbal on the links of an autopilot (`tended`). Without one do nothing."""
    if gimbal is None:
        yield
        return
    async with running_beside([("mavlink-gimbal", tended(gimbal, autopilot, clock).run(clock))]):
        yield


def tended(gimbal: Gimbal, autopilot: Autopilot, clock: Clock) -> Repeated:
    """Join a gimbal to the links of an autopilot, among whose samples its own are offered; return the work that is left to do."""

    def on_message(received: ReceivedMessage) -> None:
        sample = gimbal.on_message(autopilot, received)
        if sample is not None:
            autopilot.samples.offer(sample)

    def send() -> None:
        if autopilot.unclear is not None:
            return  # a command would reach another system with the gimbal's ids
        for message in gimbal.due(autopilot, clock.now()):
            autopilot.send(message)

    def tick() -> float:
        autopilot.links.contained.run("the gimbal's tick", "us", send)
        return _TICK_S

    autopilot.add_listener(on_message)
    return Repeated("mavlink-gimbal", tick)
