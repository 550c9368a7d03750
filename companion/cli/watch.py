"""`decklander watch`: watch drones live in the terminal, over MQTT."""

from __future__ import annotations

import argparse
import asyncio
import math
import os
import shutil
import sys
import time
import unicodedata
import uuid
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TextIO, get_args

from msgspec import structs

from companion.base import event_loop
from companion.cli.options import option
from companion.facts.records import StageRecord
from companion.parts.mqtt import messages as wire
from companion.parts.mqtt.options import MqttSettings
from companion.settings.load import load
from estimator.contracts.errors import BadInput, Recoverable, refused
from estimator.contracts.estimates import Method
from estimator.contracts.motion import G_M_S2

if TYPE_CHECKING:
    from companion.parts.mqtt.connection import BrokerEndpoint


EVENTS = 200
"""The number of events kept for each drone."""
LOAD_S = 10.0
"""Time over which the load of a drone is counted, s."""
DRONES = 256
"""The most drones that are kept, so that other writers on the broker cannot fill our memory."""
STALE_S = 3.0
"""Age from which on a state is marked as old."""
_REDRAW_S = 0.25  # interval of the display
_BACK_OFF_S = 1.0  # time to the next attempt to connect
_SILENT_S = 2.5  # time without an answer after which that is printed
_LINE_EACH_S = 1.0  # interval of lines where there is no terminal
_INCOMING = 2000  # messages that may wait


@dataclass(slots=True)
class Arrivals:
    """The arrival times of messages of one kind, by our own clock in seconds."""

    _recent: deque[float] = field(default_factory=lambda: deque(maxlen=20))

    def note(self, now_s: float) -> None:
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
    status: wire.StatusMessage | None = None
    state: wire.StateMessage | None = None
    sighting: wire.SightingMessage | None = None
    health: wire.HealthMessage | None = None
    events: deque[wire.EventMessage] = field(default_factory=lambda: deque(maxlen=EVENTS))
    arrivals: dict[str, Arrivals] = field(default_factory=dict)
    traffic: Traffic = field(default_factory=Traffic)
    copies: int = 0
    """The number of events that arrived more than once."""
    missing: int = 0
    """The count of event numbers that were skipped: dropped by the drone or lost on the way."""
    malformed: int = 0
    _ids: deque[str] = field(default_factory=lambda: deque(maxlen=EVENTS))
    _last: tuple[str, int] | None = None

    def on_message(self, leaf: str, payload: bytes, now_s: float) -> wire.EventMessage | None:
        """Take a message; return the event if it is a new one."""
        kind = leaf.partition("/")[0]
        if kind not in wire.PUBLISHED:
            return None
        self.traffic.note(now_s, len(payload))
        message = wire.decode(leaf, payload)
        if message is None:
            self.malformed += 1
            return None
        self.arrivals.setdefault(kind, Arrivals()).note(now_s)
        if isinstance(message, wire.EventMessage):
            return self._event(message)
        if kind in ("status", "state", "sighting", "health"):
            setattr(self, kind, message)
        return None

    def _event(self, event: wire.EventMessage) -> wire.EventMessage | None:
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

    def on_message(self, topic: str, payload: bytes, now_s: float) -> tuple[DroneModel, wire.EventMessage | None] | None:
        """Take a message; return its drone, and the event if it is a new one. Return None for a topic that is not ours."""
        parts = wire.split(topic)
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


_RED, _GREEN, _YELLOW, _BOLD, _DIM = "31", "32", "33", "1", "2"
_METHODS = tuple(method for method in get_args(Method) if method != "selected")
Paint = Callable[[str, str], str]


def screen(model: WatchModel, now_s: float, width: int, height: int, *, colour: bool = True) -> list[str]:
    """Return one screen: `height` lines of at most `width` columns."""

    def paint(text: str, code: str) -> str:
        return f"\x1b[{code}m{text}\x1b[0m" if colour and text else text

    lines = [_head(model, paint)]
    drone = model.shown
    if drone is None:
        lines += ["", "nothing received yet" if model.connected else ""]
    else:
        if len(model.drones) > 1:
            lines += ["", *_fleet(model, now_s, paint)]
        lines += ["", *_details(drone, now_s, width, paint)]
        room = height - len(lines) - 2
        if room > 0:
            lines += ["", paint("EVENTS", _BOLD), *(_event(e, paint) for e in list(drone.events)[-room:])]
    return [_cut(line, width) for line in lines[:height]]


def line(drone: DroneModel, event: wire.EventMessage | None) -> str:
    """Return one plain line: the event, or else the drone's state."""
    if event is not None:
        return f"{drone.name} event {event.sequence} {event.kind}: {_clean(event.text)}"
    if drone.state is None:
        return f"{drone.name} {_online(drone)}"
    vehicle = drone.state.vehicle
    battery = "" if vehicle is None or vehicle.battery_fraction is None else f" battery {100 * vehicle.battery_fraction:.0f} %"
    return f"{drone.name} {_online(drone)} {_clean(drone.state.decision.phase)}: {_where(drone)}{battery}"


def _head(model: WatchModel, paint: Paint) -> str:
    if model.connected:
        state = paint("connected", _GREEN)
    else:
        state = paint("no broker", _RED) + (f" ({_clean(model.trouble)})" if model.trouble else "")
    return f"{paint('decklander watch', _BOLD)}  {state}  {paint('ctrl-c ends', _DIM)}"


def _fleet(model: WatchModel, now_s: float, paint: Paint) -> list[str]:
    lines = [paint(f"{'DRONE':<16} {'':<8} {'PHASE':<24} {'BATTERY':<8} {'MESSAGES/S':>10} {'KB/S':>6}", _BOLD)]
    for name, drone in sorted(model.drones.items()):
        state = drone.state
        vehicle = None if state is None else state.vehicle
        battery = "--" if vehicle is None or vehicle.battery_fraction is None else f"{100 * vehicle.battery_fraction:.0f} %"
        phase = "--" if state is None else _clean(state.decision.phase)
        messages, size = drone.traffic.each_second(now_s)
        online = _pad_to(_coloured_online(drone, now_s, paint), 8)
        lines.append(f"{name[:16]:<16} {online} {phase[:24]:<24} {battery:<8} {messages:>10.1f} {size / 1e3:>6.1f}")
    return lines


def _details(drone: DroneModel, now_s: float, width: int, paint: Paint) -> list[str]:
    status, state = drone.status, drone.state
    version = "" if status is None else f"  version {_clean(status.version)}  session {_clean(status.session)}"
    lines = [f"{paint(drone.name, _BOLD)}  {_coloured_online(drone, now_s, paint)}{version}"]
    if state is not None:
        age = drone.arrivals["state"].age_s(now_s)
        old = paint(f"   {age:.0f} s old", _RED) if age is not None and age > STALE_S else ""
        lines.append(f"phase    {paint(_clean(state.decision.phase), _BOLD)}{old}")
        lines.append(f"pad      {_where(drone)}")
        if state.belief is not None:
            path, cov, v = state.belief.path, state.belief.cov, state.belief.v_pad_level
            beside_cm, height_cm = (100 * math.sqrt(max(0.0, var)) for var in (max(cov[0], cov[8]), cov[16]))
            yaw = "--" if state.belief.yaw_rad is None else f"{math.degrees(state.belief.yaw_rad):+.0f} deg"
            alert = "" if state.belief.consistent else paint("   inconsistent", _RED)
            lines.append(
                f"estimate {path}   sigma {beside_cm:.1f} cm sideways, {height_cm:.1f} cm height"
                f"   pad moves {v[0]:+.2f} {v[1]:+.2f} {v[2]:+.2f} m/s   heading {yaw}{alert}"
            )
        lines.append(f"order    {_order(drone)}")
        lines.append(f"vehicle  {_vehicle(drone, paint)}")
    if drone.sighting is not None:
        frame = drone.sighting.detection
        seen = ", ".join(name for name in _METHODS if getattr(frame, name) is not None) or "nothing"
        lines.append(f"frame    {frame.seq}: {frame.verdict.value}; seen by {seen}")
    rates = "   ".join(f"{kind} {_rate(a.rate_hz(now_s))}" for kind, a in sorted(drone.arrivals.items()) if kind != "status")
    lines.append(f"rates    {rates}")
    if drone.missing or drone.copies or drone.malformed:
        lines.append(f"         events missing {drone.missing}, copies {drone.copies}, malformed messages {drone.malformed}")
    return lines + _health(drone, width, paint)


def _health(drone: DroneModel, width: int, paint: Paint) -> list[str]:
    if drone.health is None:
        return []
    health = drone.health.health
    lines = ["", paint(f"{'PART':<12} {'':<6} {'SINCE':>8}  FAILURES", _BOLD)]
    for part in health.parts:
        word = paint("up", _GREEN) if part.up else paint("down", _RED)
        error = f"  {_clean(part.last_error)}" if part.last_error and not part.up else ""
        lines.append(f"{_clean(part.name):<12} {_pad_to(word, 6)} {_seconds(part.age_s):>8}  {part.restarts}{error}")
    frames = [tally for tally in health.tallies if tally.kind == "Frame"]
    lines += [
        "",
        *_wrapped("flows", sorted(f"{_clean(f.name)} {_rate(f.rate_hz)}" for f in health.flows), width),
        *_wrapped("stages", sorted(f"{_clean(s.name).replace('_', ' ')} {_stage(s)}" for s in health.stages), width),
        *_wrapped("frames", sorted(f"{_clean(t.verdict).replace('_', ' ')} {t.count}" for t in frames), width),
    ]
    mqtt = {c.name: c.value for c in health.counters if c.part == "mqtt"}
    if mqtt:
        lines.append(
            f"mqtt     events delivered {mqtt.get('events_delivered', 0):.0f}, waiting {mqtt.get('events_waiting', 0):.0f}, "
            f"dropped {mqtt.get('events_dropped', 0):.0f}; connection failures {mqtt.get('connection_failures', 0):.0f}"
        )
    return lines


def _wrapped(label: str, items: list[str], width: int) -> list[str]:
    """Return the items side by side after a label, on as many lines as they need."""
    lines = [f"{label:<9}" + ("" if items else "none")]
    for item in items:
        if len(lines[-1]) + len(item) > width and len(lines[-1]) > 9:
            lines.append(" " * 9)
        lines[-1] += item + "   "
    return [text.rstrip() for text in lines]


def _event(event: wire.EventMessage, paint: Paint) -> str:
    colour = {"command": _YELLOW, "phase": _GREEN}.get(event.kind, _DIM)
    return f"{event.at_ns * 1e-9:12.2f} s  {event.sequence:>6}  {paint(f'{event.kind:<8}', colour)} {_clean(event.text)}"


def _where(drone: DroneModel) -> str:
    belief = None if drone.state is None else drone.state.belief
    if belief is None:
        return "not seen yet"
    forward, right, down = belief.d_body_pad_level
    return (
        f"height {down:5.2f} m   sideways {math.hypot(forward, right):5.2f} m   forward {forward:+.2f} right {right:+.2f}"
        f"   seen {1e-9 * (belief.at_ns - belief.sighted_ns):.1f} s ago"
    )


def _order(drone: DroneModel) -> str:
    decision = None if drone.state is None else drone.state.decision
    if decision is None or decision.command is None:
        return "none"
    if decision.v_level is None or decision.yaw_rate_rad_s is None:
        return _clean(decision.command)
    forward, right, down = decision.v_level
    turn = f"turn {math.degrees(decision.yaw_rate_rad_s):+.0f} deg/s"
    if decision.a_level is not None:
        trim = decision.trim_level or [0.0, 0.0]
        ahead, beside = (math.degrees(math.atan((a + t) / G_M_S2)) for a, t in zip(decision.a_level, trim, strict=True))
        return f"lean forward {ahead:+.1f} right {beside:+.1f} deg   down {down:+.2f} m/s   {turn}"
    return f"forward {forward:+.2f} right {right:+.2f} down {down:+.2f} m/s   {turn}"


def _vehicle(drone: DroneModel, paint: Paint) -> str:
    state = drone.state
    if state is None or (vehicle := state.vehicle) is None:
        return "has sent nothing yet"
    battery = "--" if vehicle.battery_fraction is None else f"{100 * vehicle.battery_fraction:.0f} %"
    if vehicle.battery_fraction is not None and vehicle.battery_fraction < 0.2:
        battery = paint(battery, _RED)
    trouble = paint("   EMERGENCY", _RED) if vehicle.emergency else ""
    trouble += "" if vehicle.link_ok else paint("   link lost", _RED)
    age_s = 1e-9 * (state.at_ns - vehicle.stamp.received_at_ns)
    return f"{_clean(vehicle.mode)}   battery {battery}   received {age_s:.1f} s ago{trouble}"


def _online(drone: DroneModel) -> str:
    if drone.status is None:
        return "unknown"
    return "online" if drone.status.online else drone.status.reason


def _coloured_online(drone: DroneModel, now_s: float, paint: Paint) -> str:
    word = _online(drone)
    ages = [age for a in drone.arrivals.values() if (age := a.age_s(now_s)) is not None]
    if word == "online" and ages and min(ages) > STALE_S:
        return paint("silent", _YELLOW)
    return paint(word, {"online": _GREEN, "lost": _RED}.get(word, _YELLOW))


def _rate(rate_hz: float | None) -> str:
    return "--" if rate_hz is None else f"{rate_hz:.1f}/s"


def _stage(stage: StageRecord) -> str:
    if stage.p50_s is None or stage.p99_s is None:
        return "--"
    return f"{1e3 * stage.p50_s:.1f} ms (p99 {1e3 * stage.p99_s:.1f})"


def _seconds(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _clean(text: str) -> str:
    """Return received text without control characters for the terminal, one column per character."""
    return "".join((c if unicodedata.east_asian_width(c) not in "WF" else "?") if c.isprintable() else " " for c in text)


def _pad_to(text: str, width: int) -> str:
    return text + " " * max(0, width - len(_plain(text)))


def _plain(text: str) -> str:
    parts = text.split("\x1b[")
    return parts[0] + "".join(part.partition("m")[2] for part in parts[1:])


def _cut(text: str, width: int) -> str:
    """Return the line cut to at most `width` columns; attributes take none."""
    if len(_plain(text)) <= width:
        return text
    shown, out, pieces = 0, "", text.split("\x1b[")
    for k, piece in enumerate(pieces):
        code, rest = ("", piece) if k == 0 else (f"\x1b[{piece.partition('m')[0]}m", piece.partition("m")[2])
        out += code + rest[: width - shown]
        shown += min(len(rest), width - shown)
    return out


_CLEAR, _HOME, _TO_END, _BELOW, _HIDE, _SHOW = "\x1b[2J", "\x1b[H", "\x1b[K", "\x1b[J", "\x1b[?25l", "\x1b[?25h"


DESCRIPTION = (
    "Show what drones publish on an MQTT broker: a full screen on a terminal, else a line per second and a line "
    "per event. Take the broker from a settings file or from the options. Exit code 1 if --seconds pass without a "
    "connection to the broker."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    option(parser, "--config FILE", "read the broker and the credentials from [mqtt] of this settings file")
    option(parser, "--host HOST", "host name or address of the broker (default: 127.0.0.1)")
    option(parser, "--port PORT", "port of the broker (default: 8883 with TLS, 1883 without)", type=int)
    option(parser, "--user USER", "user name")
    option(parser, "--password-file FILE", "read the password from this file")
    option(parser, "--ca-file FILE", "trust the CAs in this file instead of the system's")
    option(parser, "--plain-tcp", "connect without TLS")
    option(parser, "--drone NAME", "show only this drone (default: every drone on the broker)")
    option(parser, "--seconds S", "stop after this many seconds", type=float)
    option(parser, "--schema", "print the JSON Schema of the messages instead")


def run(args: argparse.Namespace) -> int:
    """Show drones until interrupted or until `--seconds` have passed.

    Returns:
        0, or 1 if the broker was never reached.

    Raises:
        BadInput: an option or the settings file is wrong, or a secret cannot be read.
    """
    from companion.parts.mqtt.connection import renewed_endpoint

    if args.schema:
        sys.stdout.write(wire.schema())
        return 0
    if args.config is not None:
        settings = load(args.config).of(MqttSettings)
        if settings.transport == "off":
            raise BadInput(f"{args.config}: mqtt.transport is off")
    else:
        settings = MqttSettings(transport="tcp", port=1883) if args.plain_tcp else MqttSettings(transport="tls")
    settings = _changed(settings, args)
    if args.drone is not None:
        with refused("--drone", ValueError):
            wire.Topics(args.drone)
    if args.seconds is not None and not 0 < args.seconds < 1e9:
        raise BadInput(f"--seconds must be more than 0, got {args.seconds}")
    endpoint = renewed_endpoint(settings)
    out, live = sys.stdout, sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    return event_loop.run(_Watch(endpoint, args.drone, out, live).run(args.seconds))


def _changed(settings: MqttSettings, args: argparse.Namespace) -> MqttSettings:
    if args.port is not None and not 0 < args.port < 65536:
        raise BadInput(f"--port must be from 1 to 65535, got {args.port}")
    if args.password_file is not None and not (args.user or settings.user):
        raise BadInput("--password-file needs --user")
    given = {key: getattr(args, key) for key in ("host", "port", "user", "password_file", "ca_file")}
    return structs.replace(settings, **{key: value for key, value in given.items() if value is not None})


class _Watch:
    """Subscribe to the broker and show what arrives."""

    def __init__(self, endpoint: Callable[[], BrokerEndpoint], drone: str | None, out: TextIO, live: bool) -> None:
        self._endpoint = endpoint
        self._model = WatchModel(drone)
        self._topic = f"{wire.ROOT}/{drone or '+'}/+"
        self._out = out
        self._live = live
        self._printed_s: dict[str, float] = {}
        """Time at which the last line of each drone was printed, s on the monotonic clock."""
        self._reached = False
        """True if the broker ever accepted the connection."""

    async def run(self, seconds: float | None) -> int:
        """Show drones until cancelled, or for this many seconds; return the exit code."""
        if self._live:
            self._write(_HIDE + _CLEAR)
        else:
            sys.stderr.write(f"connecting to {self._where} ...\n")
        try:
            async with asyncio.timeout(seconds), asyncio.TaskGroup() as group:
                asyncio.get_running_loop().call_later(_SILENT_S, self._silent)
                group.create_task(self._listen())
                if self._live:
                    group.create_task(self._draw())
        except TimeoutError:
            pass
        finally:
            self._write(_SHOW + "\n" if self._live else "")
        if not self._reached:
            raise Recoverable(self._model.trouble or f"no answer from {self._where} within {seconds:g} s{self._hint}")
        if not self._model.drones:
            sys.stderr.write(f"connected to {self._where}, but no drone published anything\n")
        return 0

    @property
    def _where(self) -> str:
        to = self._endpoint()
        return f"broker {to.host}:{to.port} ({'plain TCP' if to.tls is None else 'TLS'})"

    @property
    def _hint(self) -> str:
        return "; a broker that expects TLS does not answer plain TCP" if self._endpoint().tls is None else ""

    async def _listen(self) -> None:
        from aiomqtt import MqttError

        from companion.parts.mqtt.connection import connect

        while True:
            try:
                name = f"decklander-watch-{uuid.uuid4().hex[:8]}"
                async with connect(self._endpoint(), name, incoming=_INCOMING) as connection:
                    await connection.subscribe_to(self._topic, qos=1, retained=True)
                    self._reached, self._model.connected, self._model.trouble = True, True, ""
                    async for publication in connection.publications():
                        self._take(publication.topic, publication.payload)
            except (Recoverable, MqttError) as why:
                explained = self._reached or isinstance(why.__cause__, OSError)
                self._troubled(str(why) if explained else f"{why}{self._hint}")
            await asyncio.sleep(_BACK_OFF_S)

    def _silent(self) -> None:
        if not self._reached and not self._model.trouble:
            self._troubled(f"nothing answers at {self._where} yet{self._hint}")

    def _troubled(self, trouble: str) -> None:
        if not self._live and trouble != self._model.trouble:
            sys.stderr.write(f"no connection: {trouble}; trying again\n")
        self._model.connected, self._model.trouble = False, trouble

    def _take(self, topic: str, payload: bytes) -> None:
        now_s = time.monotonic()
        update = self._model.on_message(topic, payload, now_s)
        if update is None or self._live:
            return
        drone, event = update
        if event is not None or now_s - self._printed_s.get(drone.name, -_LINE_EACH_S) >= _LINE_EACH_S:
            if event is None:
                self._printed_s[drone.name] = now_s
            self._write(line(drone, event) + "\n")

    async def _draw(self) -> None:
        while True:
            width, height = shutil.get_terminal_size()
            lines = screen(self._model, time.monotonic(), width, height - 1, colour="NO_COLOR" not in os.environ)
            self._write(_HOME + "".join(f"{text}{_TO_END}\r\n" for text in lines) + _BELOW)
            await asyncio.sleep(_REDRAW_S)

    def _write(self, text: str) -> None:
        self._out.write(text)
        self._out.flush()
