"""The state that `decklander watch` shows: the newest message of each kind for each drone, and its events. No I/O."""

from collections import deque
from dataclasses import dataclass, field

from companion.parts.mqtt.messages import (
    PUBLISHED,
    EventMessage,
    HealthMessage,
    SightingMessage,
    StateMessage,
    StatusMessage,
    decode,
)
from companion.parts.mqtt.topics import split

EVENTS = 200
"""The number of events kept for each drone."""
LOAD_S = 10.0
"""Time over which the load of a drone is counted, s."""
DRONES = 256
"""The most drones that are kept, so that other writers on the broker cannot fill our memory."""


@dataclass(slots=True)
class Arrivals:
    """The arrival times of messages of one kind, by our own clock in seconds."""

    count: int = 0
    _recent: deque[float] = field(default_factory=lambda: deque(maxlen=20))

    def note(self, now_s: float) -> None:
        self.count += 1
        self._recent.append(now_s)

    def age_s(self, now_s: float) -> float | None:
        return now_s - self._recent[-1] if self._recent else None

    def rate_hz(self, now_s: float) -> float | None:
        if len(self._recent) < 2:
            return None
        return (len(self._recent) - 1) / max(1e-6, now_s - self._recent[0])


@dataclass(slots=True)
class Traffic:
    """The messages of the last seconds, by our own clock."""

    _recent: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=1000))

    def note(self, now_s: float, payload_bytes: int) -> None:
        self._recent.append((now_s, payload_bytes))

    def each_second(self, now_s: float) -> tuple[float, float]:
        """Return messages/s and bytes/s of payload over the last `LOAD_S`, or since the first message if that is shorter."""
        while self._recent and now_s - self._recent[0][0] > LOAD_S:
            self._recent.popleft()
        if not self._recent:
            return 0.0, 0.0
        seconds = max(1.0, now_s - self._recent[0][0])
        return len(self._recent) / seconds, sum(size for _, size in self._recent) / seconds


@dataclass(slots=True)
class DroneModel:
    """The state of one drone, as received."""

    name: str
    status: StatusMessage | None = None
    state: StateMessage | None = None
    sighting: SightingMessage | None = None
    health: HealthMessage | None = None
    events: deque[EventMessage] = field(default_factory=lambda: deque(maxlen=EVENTS))
    arrivals: dict[str, Arrivals] = field(default_factory=dict)
    traffic: Traffic = field(default_factory=Traffic)
    copies: int = 0
    """The number of events that arrived more than once."""
    missing: int = 0
    """The count of event numbers that were skipped: dropped by the drone or lost on the way."""
    malformed: int = 0
    _ids: deque[str] = field(default_factory=lambda: deque(maxlen=EVENTS))
    _last: tuple[str, int] | None = None

    def on_message(self, leaf: str, payload: bytes, now_s: float) -> EventMessage | None:
        """Take a message; return the event if it is a new one."""
        if leaf.partition("/")[0] not in PUBLISHED:
            return None
        self.traffic.note(now_s, len(payload))
        message = decode(leaf, payload)
        if message is None:
            self.malformed += 1
            return None
        self.arrivals.setdefault(leaf.partition("/")[0], Arrivals()).note(now_s)
        match message:
            case StatusMessage():
                self.status = message
            case StateMessage():
                self.state = message
            case SightingMessage():
                self.sighting = message
            case HealthMessage():
                self.health = message
            case EventMessage():
                return self._event(message)
        return None

    def _event(self, event: EventMessage) -> EventMessage | None:
        if event.id in self._ids:
            self.copies += 1
            return None
        if self._last is not None and self._last[0] == event.spool:
            self.missing += max(0, event.sequence - self._last[1] - 1)
        self._last = (event.spool, event.sequence)
        self._ids.append(event.id)
        self.events.append(event)
        return event


@dataclass(slots=True)
class WatchModel:
    """All drones on the broker, or the one that is selected."""

    only: str | None = None
    drones: dict[str, DroneModel] = field(default_factory=dict)
    ignored: int = 0
    connected: bool = False
    trouble: str = ""

    def on_message(self, topic: str, payload: bytes, now_s: float) -> tuple[DroneModel, EventMessage | None] | None:
        """Take a message; return its drone, and the event if it is a new one. Return None for a topic that is not ours."""
        parts = split(topic)
        if parts is None or (self.only is not None and parts[0] != self.only):
            self.ignored += 1
            return None
        name, leaf = parts
        if name not in self.drones and len(self.drones) >= DRONES:
            self.ignored += 1
            return None
        drone = self.drones.setdefault(name, DroneModel(name))
        return drone, drone.on_message(leaf, payload, now_s)

    @property
    def shown(self) -> DroneModel | None:
        """Return the drone whose details are shown: the selected one, else the first by name."""
        return self.drones[min(self.drones)] if self.drones else None
