"""An autopilot as vehicle: open the links, find the autopilot, request its streams, return samples, send commands."""

import logging
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager

import numpy as np
from msgspec import Struct, field

from drivers.mailbox import Latest, Line
from drivers.mavlink.access import AccessLevel, NamedSenders, Source
from drivers.mavlink.boot_clock import BootClock
from drivers.mavlink.custody import LEFT_ALONE, Authority, Hand, HandEvent
from drivers.mavlink.dialect import Message, TimeSyncV2, mav
from drivers.mavlink.failsafe import UNNAMED
from drivers.mavlink.joined_texts import JoinedTexts
from drivers.mavlink.links import Link, LinkOptions, Links, ReceivedMessage, kept_open
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.origins import Origins
from drivers.mavlink.requests import RATES_HZ, Parameters, RateLimit, Streams, VersionRequest, is_for
from drivers.mavlink.roster import Bound, IdConflict, Roster
from drivers.mavlink.samples import (
    SAMPLE_PARAMETERS,
    LocalPosition,
    MavlinkSampler,
    inertial_delay_s,
    jerk_max_m_s3,
    tilt_max_deg,
)
from drivers.mavlink.setpoint_streamer import SetpointStreamer
from drivers.mavlink.take_off import Rested
from drivers.mavlink.timesync import TimeSync, answer_to
from drivers.mavlink.vehicle import VELOCITY_MODE, Condition, Identity, Stack, Version, is_autopilot, stack_of, version_of
from drivers.reconnect import Repeated, running_beside
from estimator.contracts.commands import Command, CutMotors, Hover, Lean, LeaveEmergency, Velocity
from estimator.contracts.errors import Recoverable
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import SAMPLE_QUEUE_ITEMS, Attitude, Frame, GeoFix, Sample
from estimator.contracts.time import Clock, MonoNs, seconds_between

_log = logging.getLogger(__name__)

_PROBE_S = 1.0  # interval of messages to a silent address: a listening peer does not know this program's before it receives one
_UNREQUESTED_S = 0.02  # time after which messages are handled that no part of the service has taken
_TIMED_S = 0.006  # the same after a request for the time: PX4 drops round trips of TIMESYNC above 10 ms
_TIMED_FOR_S = 1.0  # time after such a request for which it holds: PX4 requests the time ten times a second
_WARNING = 4
"""MAV_SEVERITY_WARNING; what is graver has a lower number."""
_BEFORE_S = 5.0  # time before the vehicle was taken from which on the autopilot's texts are about it: PX4 waits 5 s in Hold
_AFTER_S = 2.0  # time after the vehicle was taken up to which they are
_AGAIN_S = 5.0
"""The shortest time between two rounds of requests, whatever the autopilot does."""
_REQUESTS_HZ = 20.0  # requests for streams and parameters a second
_REQUESTS_MAX = 100  # requests for streams and parameters at once
_MOVED_S = 0.1
"""Time for which an autopilot must send from another port of its host alone to count as moved."""
_OVERTAKEN_S = 0.05  # time by which a message of the old port may be late
_HOLDER = {Hand.NOBODY: "nobody", Hand.PERSON: "a person", Hand.CUT: "nobody, its motors are cut,"}
_BY_ITSELF = (HandEvent.FAILSAFE, HandEvent.RESTS)
_BEAT_S = 5.0
"""Age of the newest HEARTBEAT beyond which nothing is commanded: mode and motors may be others by then."""
_BESIDE_S = 5.0
"""Time for which nothing is followed once two senders have used the autopilot's ids at the same time."""


class _Known(Struct):
    """The state that belongs to the autopilot once it is found."""

    identity: Identity
    sync: TimeSync
    clock: BootClock
    sampler: MavlinkSampler
    streams: Streams
    parameters: Parameters
    streamer: SetpointStreamer
    source: Source
    """The link and the peer that its messages come from; a message with its ids from elsewhere is not accepted as its own."""
    received_at: MonoNs
    beat_at: MonoNs
    """Time of the newest HEARTBEAT."""
    origins: Origins = field(default_factory=Origins)
    lost: bool = False
    mute: bool = False
    """True while its HEARTBEATs have ended and other messages go on."""
    version: Version | None = None
    """Its firmware and hardware, once it reported them."""
    hand: Hand = Hand.NOBODY
    """The holder of the vehicle that was last reported."""
    released_at: MonoNs | None = None
    """Time when the vehicle was taken from this program; None while it was not."""
    suspended: bool = False
    """True while it is not clear who is the autopilot, and the hold for that was sent."""


class Autopilot:
    """An open link to an autopilot: read `samples`, give a `command`, add a listener, `send` messages. See `open_autopilot`."""

    def __init__(
        self,
        options: AutopilotOptions,
        links: Links,
        clock: Clock,
        parameters: tuple[str, ...],
        authority: Authority = Authority.SETPOINTS,
    ) -> None:
        self._o, self._authority = options, authority
        self._wanted = parameters
        self._clock = clock
        self._open = True
        self._known: _Known | None = None
        self._listeners: list[Callable[[ReceivedMessage], None]] = []
        self._taken_at = self._ticked_at = clock.now()
        self._timed_at: MonoNs | None = None
        """Time of the newest TIMESYNC request; None before the first."""
        self._boots = (0, 0)
        self._knocked: MonoNs | None = None
        self._requests = RateLimit(_REQUESTS_HZ, _REQUESTS_MAX)
        self._requested: MonoNs | None = None
        """Time when everything was last requested."""
        self._request_due = False
        self._version = VersionRequest()
        self._roster = Roster(options)
        self._reopened = list(links.opened)
        self._beside_at: MonoNs | None = None
        """Time of the last message of another sender with the autopilot's ids, while the autopilot sent too."""
        self._moving: tuple[Source, MonoNs] | None = None
        """Address from which the autopilot may continue, and the time since when."""
        self.links = links
        links.follows = self._follows
        self.frames: Latest[Frame] = Latest()
        """An autopilot has no frames; a camera driver offers them here."""
        self.samples: Line[Sample] = Line(SAMPLE_QUEUE_ITEMS, self._take_waiting)
        self.texts: deque[tuple[MonoNs, int, str]] = deque(maxlen=100)
        """The newest STATUSTEXTs of the autopilot, each as (received_at, severity, text)."""
        self._joined = JoinedTexts()
        self.events: deque[int] = deque(maxlen=100)
        """The numbers of the newest EVENTs, by which PX4 reports what ArduPilot reports in texts."""
        self.counts: Counter[str] = Counter()
        """The number of messages of the autopilot, by name."""
        self.connects = 0
        self.deck_velocity: Callable[[MonoNs], F64] = lambda now: np.zeros(3)
        """Returns the velocity that commanded velocities are relative to, a moving deck's: (3,) m/s in ned; 0 by default."""

    @property
    def identity(self) -> Identity | None:
        """The identity of the autopilot, None until one was found."""
        return None if self._known is None else self._known.identity

    @property
    def version(self) -> Version | None:
        """The firmware and hardware of the autopilot; None while they are not known."""
        return None if self._known is None else self._known.version

    @property
    def connected(self) -> bool:
        """True if the autopilot sent a message lately, and a HEARTBEAT."""
        return self._known is not None and not (self._known.lost or self._known.mute)

    @property
    def id_conflicts(self) -> tuple[IdConflict, ...]:
        """Ambiguities about which component is the autopilot, or about our own id."""
        return self._roster.found

    @property
    def unclear(self) -> str | None:
        """Reason why nothing may be commanded: the autopilot is ambiguous. None while it is clear."""
        return self._roster.unclear

    @property
    def condition(self) -> Condition:
        """The condition that the autopilot reports."""
        return Condition() if self._known is None else self._known.sampler.condition

    @property
    def attitude(self) -> Attitude | None:
        return None if self._known is None else self._known.sampler.attitude

    @property
    def positions(self) -> tuple[LocalPosition, ...]:
        """The newest local positions, oldest first."""
        return () if self._known is None else tuple(self._known.sampler.positions)

    @property
    def refused(self) -> int:
        """The number of messages of the autopilot whose values no sensor can have measured."""
        return 0 if self._known is None else self._known.sampler.refused.total()

    @property
    def out_of_order(self) -> int:
        """The number of messages of the autopilot that a newer one had overtaken, or that came twice."""
        return 0 if self._known is None else self._known.sampler.out_of_order.total()

    @property
    def sync(self) -> TimeSync | None:
        return None if self._known is None else self._known.sync

    @property
    def boot_clock(self) -> BootClock | None:
        """The map of the autopilot's time since boot to ours."""
        return None if self._known is None else self._known.clock

    @property
    def parameters(self) -> Parameters | None:
        return None if self._known is None else self._known.parameters

    @property
    def streams(self) -> Streams | None:
        return None if self._known is None else self._known.streams

    @property
    def streamer(self) -> SetpointStreamer | None:
        return None if self._known is None else self._known.streamer

    @property
    def rested(self) -> Rested | None:
        """Return where the vehicle last stood, and its velocity then; None if it never did."""
        return None if self._known is None else self._known.streamer.rested

    @property
    def steered(self) -> bool:
        """Return whether this program steers the vehicle."""
        return self._known is not None and self._known.streamer.hand not in LEFT_ALONE

    def command(self, command: Command) -> None:
        """Take the newest command; it is flown as `SetpointStreamer` says.

        The cut of the motors, and a person's hold, are taken for a silent autopilot too: it may receive although nothing comes
        back, and the cut is repeated until it is reported. While several autopilots make it unclear who is meant, the cut goes
        to the one that was commanded last: that is the one in whose flight a person saw a
        danger, and the HEARTBEAT of another must not be able to prevent it.

        Raises:
            Recoverable: the link was closed, no autopilot is connected, or it is not clear who is the autopilot.
        """
        if not self._open:
            raise Recoverable("the link to the autopilot is closed")
        known = self._known
        why = self.unclear if self.connected else "no autopilot is connected"
        ends = isinstance(command, CutMotors | LeaveEmergency) or (isinstance(command, Hover) and command.calls_off)
        if known is not None and (why is None or (ends and (known.streamer.commanded or self.unclear is None))):
            self._take(known, command)
        if why is not None:
            raise Recoverable(why)

    def _take(self, known: _Known, command: Command) -> None:
        now, v_deck_level = self._clock.now(), None
        if isinstance(command, Velocity | Lean | Hover) and self.attitude is not None:
            # The autopilot's velocities are over the ground, as a tilt's are.
            v_deck_level = Rotation.from_rpy(0.0, 0.0, self.attitude.R_ned_body.rpy_rad[2]).inv @ self.deck_velocity(now)
            if isinstance(command, Velocity):
                command = Velocity(command.v_level + v_deck_level, command.yaw_rate_rad_s)
        known.streamer.take(command, now, v_deck_level)
        self._tell_hand(known, now)

    def release(self) -> None:
        """Do nothing, because closing commands the autopilot to hold, and it then holds by itself."""

    def engage(self) -> None:
        """Allow a vehicle that a person took over to be taken back, because the operator starts."""
        if self._known is not None:
            self._known.streamer.engage()
            self._tell_hand(self._known, self._clock.now())

    def is_own(self, received: ReceivedMessage) -> bool:
        """Return whether a message is the autopilot's own, by way of a peer whose messages are read."""
        at = None if self._known is None else self._known.identity.address
        return at == (received.system, received.component) and received.access_level >= AccessLevel.PEER

    def send(self, message: Message) -> bool:
        """Send a message to the autopilot if one is known; return whether it was sent."""
        return self._known is not None and self.links.send(message, self._known.source)

    def take_ranges(self, take: bool) -> None:
        """Set whether its DISTANCE_SENSOR is used; it is no measurement if the autopilot only echoes what this program sent."""
        if self._known is not None:
            self._known.sampler.ranges = take

    def add_listener(self, listener: Callable[[ReceivedMessage], None]) -> None:
        """Call `listener` with every message of every link except our own, before it becomes samples. It must be quick."""
        self._listeners.append(listener)

    def remove_listener(self, listener: Callable[[ReceivedMessage], None]) -> None:
        """Call this listener no more.

        Raises:
            ValueError: it was not added.
        """
        self._listeners.remove(listener)

    @property
    def work(self) -> tuple[Repeated, ...]:
        """Its work while the link is open: it reads waiting messages, and sends what is due."""
        ticks = Repeated("autopilot-tick", self._tick, self._o.command_period_s)
        return (Repeated("autopilot-read", self._read_waiting), ticks) if self.links.waits else (ticks,)

    def _read_waiting(self) -> float:
        """Handle what has waited long enough; return the time until the next look, s."""
        now = self._clock.now()
        timed = self._timed_at is not None and seconds_between(self._timed_at, now) < _TIMED_FOR_S
        most_s = _TIMED_S if timed else _UNREQUESTED_S
        if (waits_s := most_s - seconds_between(self._taken_at, now)) > 0.0:
            return waits_s
        self._take_waiting()
        return most_s

    async def _read(self) -> None:
        async for received in self.links.received:
            self._handle(received)

    def _take_waiting(self) -> None:
        """Handle what waits. Guidance, vision and the setpoints ask for it just before they need it.

        Most of the time that the loop spends on a datagram is spent on waking for it, hundreds of times a second.
        """
        if self.links.waits:
            self._taken_at = self._clock.now()
            for received in self.links.waiting():
                self._handle(received)

    def _handle(self, received: ReceivedMessage) -> None:
        if (received.system, received.component) == self.links.identity:
            if not self.links.sent_by_us(received):  # else it was routed back
                self._roster.on_namesake(received.received_at)
            return
        for handler in (self._on_message, *self._listeners):
            try:
                handler(received)
            except Exception as why:
                self.links.contained.hold(received.place, received.source_text, why)

    def _on_message(self, received: ReceivedMessage) -> None:
        message, name = received.message, received.message.get_type()
        if name == "TIMESYNC" and received.access_level >= AccessLevel.PEER:
            # The middle of the time for which the request waited here, so that the asker's half of the round trip fits.
            middle = MonoNs((received.received_at + self._clock.now()) // 2)
            answer = answer_to(message, middle, (received.system, received.component), self.links.identity)
            if answer is not None:
                self._timed_at = received.received_at
                self.links.send(answer, received.source)
        if name == "HEARTBEAT" and is_autopilot(message, received.component):
            self._on_heartbeat(received)
        known = self._known
        if known is None or received.system != known.identity.system or received.component != known.identity.component:
            if self._o.vessel_id == received.system and known is not None and received.access_level >= AccessLevel.REPORTER:
                self.samples.offer_all(known.sampler.vessel(message, received.received_at))
            return
        if received.source != known.source:
            return  # the same message by another path, or another sender that uses its ids
        for one in known.origins.sort(message, received.received_at):
            self._on_own_message(known, one, received.received_at)

    def _on_own_message(self, known: _Known, message: Message, received_at: MonoNs) -> None:
        """Process a message that is the autopilot's own."""
        name = message.get_type()
        if known.lost:
            known.lost = False
            self._roster.uids.clear()
            self._request_due = True
            _log.info("autopilot: connected again, requesting its streams")
        known.received_at = received_at
        self.counts[name] += 1
        if name == "COMMAND_ACK" and not is_for(message, self.links.identity):
            return
        self._on_kind(name, known, message, received_at)
        known.streams.on_message(message, received_at)
        samples = known.sampler.samples(message, received_at)
        for sample in samples:
            if type(sample) is GeoFix:
                known.streamer.on_place(sample.place, received_at)
        self.samples.offer_all(samples)
        known.streamer.on_condition(known.sampler.condition, received_at, beat=name == "HEARTBEAT")
        self._tell_hand(known, received_at)
        if name == "LOCAL_POSITION_NED" and known.sampler.positions:
            position = known.sampler.positions[-1]
            known.streamer.on_position(float(position.p_body_ned[2]))
            known.streamer.on_velocity(position.v_body_ned, position.p_body_ned, received_at)
        elif name in ("ATTITUDE_QUATERNION", "ATTITUDE") and known.sampler.attitude is not None:
            known.streamer.on_attitude(known.sampler.attitude)

    def _on_kind(self, name: str, known: _Known, message: Message, received_at: MonoNs) -> None:
        """Process what only messages of this kind hold, and the samples do not."""
        if name == "HEARTBEAT":
            known.beat_at, known.mute = received_at, False
            self._roster.on_own_heartbeat(message)
        elif name == "TIMESYNC":
            known.sync.on_message(message, received_at)
        elif name == "STATUSTEXT":
            for severity, text in self._joined.on_message(message, known.identity.address):
                self.texts.append((received_at, severity, text))
                known.sampler.on_text(text, received_at)
        elif name == "COMMAND_ACK" and message.result != mav.MAV_RESULT_IN_PROGRESS:
            if (message.target_system, message.target_component) == self.links.identity:
                known.streamer.on_answer(int(message.command), accepted=message.result == mav.MAV_RESULT_ACCEPTED)
        elif name == "EVENT":
            self.events.append(int(message.id))
        elif name == "AUTOPILOT_VERSION":
            self._on_version(known, message)
        elif name in ("PARAM_VALUE", "PARAM_ERROR"):
            known.parameters.on_message(message)
            known.sampler.inertial_delay_s = inertial_delay_s(known.identity.stack, known.parameters.values)
            known.sampler.jerk_max_m_s3 = jerk_max_m_s3(known.parameters.values)
            known.sampler.tilt_max_deg = tilt_max_deg(known.identity.stack, known.parameters.values)

    def _tell_hand(self, known: _Known, now: MonoNs) -> None:
        """Say in the vehicle's status who has taken it, as soon as that or the autopilot's word for it changes."""
        streamer, sampler = known.streamer, known.sampler
        if streamer.hand is not known.hand and streamer.cause is not None:
            level = logging.WARNING if streamer.hand is Hand.PERSON else logging.INFO
            mode, cause = sampler.condition.mode, streamer.cause.value
            holder = "the autopilot" if streamer.cause in _BY_ITSELF else _HOLDER.get(streamer.hand, "this program")
            _log.log(level, "autopilot: %s has the vehicle, mode %s: %s", holder, mode, cause)
            known.hand = streamer.hand
        taken = self._taken(known, now)
        if (taken, streamer.motors_cut, streamer.others_at) != (sampler.taken, sampler.motors_cut, sampler.others_at):
            sampler.taken, sampler.motors_cut, sampler.others_at = taken, streamer.motors_cut, streamer.others_at
            self.samples.offer(sampler.status(now, link_ok=self.connected))

    def _taken(self, known: _Known, now: MonoNs) -> str | None:
        """Return who has taken the vehicle, with the autopilot's critical text about it; None while it is not taken."""
        if known.streamer.hand is not Hand.PERSON or known.sampler.condition.armed is False:
            known.released_at = None
            return None
        known.released_at = known.released_at or now
        words, stack, mode = self._words(known, known.released_at), known.identity.stack.value, known.sampler.condition.mode
        if known.streamer.cause is HandEvent.REFUSED:
            why = f"{stack} refused the mode {VELOCITY_MODE.get(known.identity.stack, '')}"
        elif known.streamer.cause is HandEvent.RESET:
            why = "nobody commands it since the reset"
        elif known.streamer.cause is HandEvent.RESTS:
            why = f"guidance was silent, and {stack} holds by itself"
        else:
            by_itself = words or known.streamer.cause is HandEvent.FAILSAFE
            why = f"{stack} took the vehicle" if by_itself else "the vehicle was taken over"
        return f"{why}: {words} (mode {mode})" if words else f"{why}: mode {mode}"

    def _words(self, known: _Known, taken_at: MonoNs) -> str:
        """Return the autopilot's words about that: the name of a failsafe, else its gravest text; empty without any."""

        def about(at: MonoNs) -> bool:
            return -_BEFORE_S <= seconds_between(taken_at, at) <= _AFTER_S

        failsafe = known.sampler.failsafes.newest
        if failsafe is not None and failsafe.words != UNNAMED and about(failsafe.since):
            return failsafe.words
        texts = [(severity, -at, text) for at, severity, text in self.texts if severity <= _WARNING and about(at)]
        return min(texts)[2] if texts else ""

    def _on_version(self, known: _Known, message: Message) -> None:
        before, known.version = known.version, version_of(message)
        self._version.answered = True
        self._roster.note_uid(known.version.uid, self._clock.now())
        if known.version != before:
            _log.info("autopilot: system %d has %s", known.identity.system, known.version)

    def _on_heartbeat(self, received: ReceivedMessage) -> None:
        """Take its sender as the autopilot where it is the one that is meant, or where the autopilot comes from elsewhere now."""
        self._roster.on_heartbeat(received)
        known, now = self._known, received.received_at
        if received.system == self._o.vessel_id or not self._roster.chosen(received.system, self._bound(now), now):
            return
        if known is None or received.system != known.identity.system or known.identity.stack is not stack_of(received.message):
            self._meet(received)
        elif received.source != known.source:
            if known.lost:
                _log.warning("autopilot: connected again from another address: %s", received.source_text)
                self.links.bind_autopilot(received)
                known.source, known.origins = received.source, Origins()
            else:
                self._roster.on_elsewhere(received)

    def _follows(self, received: ReceivedMessage) -> bool:
        """Go on listening to the autopilot where it is now, and return True, if a sender of its link carries on its messages.

        A router gives a new port to a connection. Until an answer goes there, no command arrives.
        """
        known, at, peer = self._known, received.received_at, received.peer
        if known is None or received.source == known.source or received.link != known.source[0]:
            return False
        if (received.system, received.component) != (known.identity.system, known.identity.component):
            return False
        before = known.source[1]
        same_host = before is not None and peer is not None and before[0] == peer[0]
        if self._moving is None or self._moving[0] != received.source:
            carries_on = (same_host or self.links.all[received.link].signed) and known.origins.continues(received.message, at)
            self._moving = (received.source, at) if carries_on else None
            return False
        since = self._moving[1]
        if seconds_between(since, known.received_at) > _OVERTAKEN_S:
            self._moving, self._beside_at = None, at
            return False
        if seconds_between(since, at) < _MOVED_S or (
            self._beside_at is not None and seconds_between(self._beside_at, at) < _BESIDE_S
        ):
            return False
        _log.warning("autopilot: it moved to another port: %s", received.source_text)
        self.links.bind_autopilot(received)
        known.source, self._moving = received.source, None
        return True

    def _bound(self, now: MonoNs) -> Bound | None:
        known = self._known
        if known is None:
            return None
        return Bound(
            known.identity.system,
            seconds_between(known.received_at, now),
            known.lost,
            self.steered or known.streamer.hand is Hand.CUT,
            known.origins.several(now),
        )

    def _meet(self, received: ReceivedMessage) -> None:
        """Take the sender of a HEARTBEAT as the autopilot."""
        before, stack = self._known, stack_of(received.message)
        self.links.bind_autopilot(received)
        identity = Identity(received.system, received.component, stack, int(received.message.type))
        sync = TimeSync()
        clock = BootClock(sync)
        sampler = MavlinkSampler(stack, clock, tell=lambda text: _log.warning("autopilot: %s", text))
        parameters = Parameters(stack, self._wanted_of(stack))
        streams, streamer = Streams(RATES_HZ[stack]), SetpointStreamer(identity, self._o, self._authority)
        at = received.received_at
        self._known = _Known(identity, sync, clock, sampler, streams, parameters, streamer, received.source, at, at)
        self.links.identify(received.system, self._o.component_id)
        self._boots = (0, 0)
        self._version = VersionRequest()
        self._roster.uids.clear()
        self.connects += 1
        where = self.links.all[received.link].endpoint
        _log.info("autopilot: %s, system %d, on %s", stack.value, received.system, where)
        if before is not None and before.identity.system != received.system:
            why = "is silent" if before.lost else "does not fly"
            _log.warning(
                "autopilot: system %d is taken in place of system %d, which %s; vehicle.system_id chooses one for good",
                received.system,
                before.identity.system,
                why,
            )

    def _wanted_of(self, stack: Stack) -> tuple[str, ...]:
        return (*SAMPLE_PARAMETERS.get(stack, ()), *self._wanted)

    def _restart_requests(self, known: _Known, now: MonoNs) -> None:
        self._request_due, self._requested = False, now
        self.connects += 1
        known.streams.restart()
        known.parameters.request(self._wanted_of(known.identity.stack))
        self._version = VersionRequest()

    def _tick(self) -> float:
        """Do what is due; return the time until the next tick, s."""
        self._take_waiting()
        before, known, now = self._ticked_at, self._known, self._clock.now()
        self._ticked_at = now
        self._judge(now)
        if known is not None:
            # What came while this process stood still is not read yet: that is no silence of the autopilot.
            self._period(known, now, listened=seconds_between(before, now) < 0.5 * self._o.silence_s)
        elif self._knocked is None or seconds_between(self._knocked, now) >= _PROBE_S:
            # A listening peer does not know this program's address before it has received something.
            self._knocked = now
            self.links.send(TimeSyncV2(0, now))
        return self._o.command_period_s

    def _judge(self, now: MonoNs) -> None:
        """Judge who is who."""
        self._roster.judge(self._bound(now), self.links.identity, now)
        if len(self._roster.uids) > 1 and self._version.done(now):
            self._version = VersionRequest()  # whether both are still there

    def _period(self, known: _Known, now: MonoNs, *, listened: bool) -> None:
        for message in known.origins.due(now):
            self._on_own_message(known, message, now)
        self._note_silence(known, now, listened=listened)
        unclear = self.unclear is not None
        if known.streamer.hand is Hand.CUT or not (known.lost or known.mute or unclear):
            self._send_all(known, known.streamer.period(now))
        elif unclear and not (known.suspended or known.mute):
            self._send_all(known, known.streamer.suspend(now))
        known.suspended = unclear
        self._tell_hand(known, now)
        if not known.lost:
            self._send_requests(known, now)

    def _note_silence(self, known: _Known, now: MonoNs, *, listened: bool) -> None:
        if listened and not known.lost and seconds_between(known.received_at, now) > self._o.silence_s:
            known.lost = True
            self.samples.offer(known.sampler.status(now, link_ok=False))
            _log.warning("autopilot: silent for %.1f s", self._o.silence_s)
        elif not (known.lost or known.mute) and listened and seconds_between(known.beat_at, now) > _BEAT_S:
            known.mute = True
            self.samples.offer(known.sampler.status(now, link_ok=False))
            _log.warning(
                "autopilot: no HEARTBEAT for %.0f s, although it sends: its mode is unknown, nothing is commanded", _BEAT_S
            )

    def _send_requests(self, known: _Known, now: MonoNs) -> None:
        link = known.source[0]
        opened, boots = self.links.opened[link], (known.clock.restarts, known.origins.changes)
        if boots[0] > self._boots[0]:
            _log.warning("autopilot: its clock went back: it restarted, or another one has its ids")
        if boots != self._boots or opened != self._reopened[link]:
            self._request_due |= self.connects > 0 and self._reopened[link] > 0
            self._boots, self._reopened[link] = boots, opened
        if self._request_due and (self._requested is None or seconds_between(self._requested, now) >= _AGAIN_S):
            self._restart_requests(known, now)
        target = known.identity.address
        self._send_all(known, known.sync.due(now, target))
        for request in (known.streams.due, known.parameters.due, self._version.due):
            if self._requests.allows(now):
                messages = request(now, target)
                self._requests.spend(len(messages))
                self._send_all(known, messages)

    def _send_all(self, known: _Known, messages: Sequence[Message]) -> None:
        for message in messages:
            self.links.send(message, known.source)

    def _close(self) -> None:
        self._open = False
        if self._known is not None and self.connected and self.unclear is None:
            for message in self._known.streamer.leave(self._clock.now()):
                self.links.send(message, self._known.source)
        closed = Recoverable("the link to the autopilot is closed")
        self.frames.fail(closed)
        self.samples.fail(closed)


def links_of(
    options: AutopilotOptions, clock: Clock, links: Sequence[LinkOptions], *, waits: bool, made_of: type[Link] = Link
) -> Links:
    """Return the links to an autopilot, which nobody keeps open yet; the arguments are those of `open_autopilot` and `Links`."""
    identity = (options.system_id or 1, options.component_id)
    access = NamedSenders(options.named_operators(), frozenset({options.vessel_id} - {0}))
    return Links(links, clock, identity, access, waits=waits, made_of=made_of)


@asynccontextmanager
async def open_autopilot(
    options: AutopilotOptions,
    clock: Clock,
    links: Sequence[LinkOptions] | None = None,
    *,
    parameters: tuple[str, ...] = (),
    waits: bool = False,
    authority: Authority = Authority.SETPOINTS,
) -> AsyncIterator[Autopilot]:
    """Open the links and keep them open; it does not wait for the autopilot (see `Autopilot.connected`).

    Leaving the block for any reason commands the vehicle to hold, or to continue a commanded landing. Until the autopilot is
    found, messages are sent as system 1.

    Args:
        links: the links of the options with their keys; None for those of the options without any key.
        parameters: names of the autopilot's parameters that are read on each connect.
        waits: let datagrams wait until samples are taken or setpoints sent, instead of waking the loop for each.
        authority: what may be sent to move the vehicle, whoever orders it.
    """
    if links is None:
        links = tuple(LinkOptions(endpoint, limits=options) for endpoint in options.endpoints())
    async with kept_open(links_of(options, clock, links, waits=waits), links) as opened:
        autopilot = Autopilot(options, opened, clock, parameters, authority)
        reading = [] if waits else [("autopilot-read", autopilot._read())]
        async with running_beside([*reading, *((one.name, one.run(clock)) for one in autopilot.work)]):
            try:
                yield autopilot
            finally:
                autopilot._close()
