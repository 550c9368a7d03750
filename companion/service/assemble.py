"""Make the daemon from settings, and run it as a process with signals. Settings that have worked are `Proven`."""

from __future__ import annotations

import hashlib
import logging
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import msgspec
from msgspec import Struct, structs

from companion.base import memory
from companion.base.containment import Body, RestartablePart
from companion.base.event_loop import heeded
from companion.base.health import SHIP_PLACE, Health
from companion.base.loop_lag import LoopWatch
from companion.base.mission import FlightOutcome
from companion.base.observer import Decision, NullObserver, Observer, ProcessedFrame
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.base.signals import PROCESS, threads
from companion.base.watchdog import Manager, Pulse, watchdog_interval_s
from companion.base.worker import Worker
from companion.guidance.flight_memory import FlightMemory
from companion.guidance.pilot import Pilot
from companion.guidance.pilot_operator import PilotOperator
from companion.parts.operator.client import OFF, socket_path
from companion.parts.operator.local_socket import OperatorSocket
from companion.service.daemon import Daemon, DaemonSetup
from companion.service.vehicle_parts import vehicle_parts
from companion.settings import schema
from companion.settings.model import Settings
from companion.settings.remarks import sources
from drivers.clock import SystemClock
from drivers.mailbox import Line
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.vehicle import modes_left
from drivers.one_source import SourceChoice
from estimator.contracts.errors import BadInput, DecklanderError, Recoverable, in_words
from estimator.contracts.samples import Sample
from estimator.contracts.time import Clock, MonoNs, seconds_between

# Treat settings that have worked since this computer was switched on as right, whatever fails later.
#
# systemd does not restart a service that ends with exit code 2, because wrong settings stay wrong. But what looks like a wrong
# setting may be a camera that is not ready yet, or a file on a failing disk, after a crash in flight. So the first frame that
# came with certain settings is noted in $RUNTIME_DIRECTORY, which survives restarts but not a reboot. From then on the same
# error counts as a failure outside the service: exit code 1, and a restart.


class Proven(NullObserver):
    """An observer that notes the first frame.

    Args:
        settings: the settings of this run.
    """

    name = "proven"

    def __init__(self, settings: Settings, environment: Mapping[str, str] = os.environ) -> None:
        folder = environment.get("RUNTIME_DIRECTORY", "").split(":")[0]
        self._path = Path(folder) / "proven" if folder else None
        self._digest = hashlib.sha256(schema.toml(settings).encode()).hexdigest()
        self._noted = False

    @property
    def known(self) -> bool:
        """True if a frame came with these settings in this run or an earlier one."""
        if self._noted or self._path is None:
            return self._noted
        try:
            return self._path.read_text().strip() == self._digest
        except (OSError, ValueError):
            return False

    def on_frame(self, processed: ProcessedFrame) -> None:
        if not self._noted:
            self._noted = True
            if self._path is not None:
                self._path.write_text(self._digest + "\n")

    @contextmanager
    def excusing(self) -> Iterator[None]:
        """Turn an error about settings that are `known` into a recoverable one.

        Raises:
            Recoverable: in place of that `BadInput`.
        """
        try:
            yield
        except BadInput as why:
            if not self.known:
                raise
            raise Recoverable(f"{why} (with these settings it has worked before)") from why
        except BaseExceptionGroup as group:
            wrong, other = group.split(BadInput)
            if wrong is None or (other is not None and other.split(DecklanderError)[1] is not None) or not self.known:
                raise
            raise Recoverable(f"{in_words(wrong)} (with these settings it has worked before)") from group


log = logging.getLogger(__name__)

# Keep what the service knows of its flight in a file, beside the flight, for the service that comes after it.

_EACH_S = 0.5
"""Time between two records, s; a change of state is written at once."""
_LONGEST = 4096
"""Most bytes that are read."""


ModesLeft = Callable[[str], tuple[str, ...]]


class FlightRecord(Struct, frozen=True, forbid_unknown_fields=True):
    """The file: one JSON object."""

    boot: str
    """The computer's start, by whose clock the memory is dated."""
    vehicle: str
    memory: FlightMemory


class FlightKeeper(NullObserver):
    """Writes the flight's memory, and gives the pilot that of the service before.

    The file is replaced as a whole. A thread writes it, so a disk that hangs costs records and no guidance cycle. It is one
    thread for all records: on a loaded computer the start of a thread holds the event loop for a second.

    Args:
        vehicle: the vehicle's name; the memory of another one is not used.
        boot: a word for this start of the computer.
        modes: returns the modes of a vehicle that nobody has taken since it was in a mode; none where modes do not say.
    """

    def __init__(self, path: Path, pilot: Pilot, vehicle: str, boot: str, modes: ModesLeft) -> None:
        self._path, self._pilot, self._vehicle, self._boot, self._modes = path, pilot, vehicle, boot, modes
        self._written: MonoNs | None = None
        self._writer, self._failed = Worker("flight-memory"), False
        if (before := self._read()) is not None:
            pilot.landing.before = before

    def _read(self) -> FlightMemory | None:
        try:
            with self._path.open("rb") as file:
                kept = msgspec.json.decode(file.read(_LONGEST), type=FlightRecord)
        except FileNotFoundError:
            return None
        except (OSError, msgspec.DecodeError) as why:
            log.error("the flight's memory %s cannot be used (%s): a flight begins as the settings say", self._path, why)
            return None
        return kept.memory if (kept.boot, kept.vehicle) == (self._boot, self._vehicle) else None

    def on_decision(self, decision: Decision) -> None:
        """Write the memory where it is due and the write before has ended."""
        due = self._written is None or seconds_between(self._written, decision.at) >= _EACH_S or decision.transitions
        memory = self._pilot.landing.memory
        if not due or memory is None or self._writer.busy:
            return
        self._written = decision.at
        if (status := self._pilot.landing.vehicle) is not None:
            memory = structs.replace(memory, modes=self._modes(status.mode))
        text = msgspec.json.encode(FlightRecord(self._boot, self._vehicle, memory))
        self._writer.run(self._write, text)

    def _write(self, text: bytes) -> None:
        try:
            # No fsync: what dies is the process, not the computer.
            scratch = self._path.with_name(self._path.name + ".new")
            scratch.write_bytes(text)
            scratch.replace(self._path)
        except OSError as why:
            if not self._failed:
                log.error("the flight's memory %s cannot be written (%s)", self._path, why)
            self._failed = True


def no_modes(mode: str) -> tuple[str, ...]:
    """Return none: this vehicle's modes do not say who has it."""
    return ()


def keeper_of(pilot: Pilot, vehicle: str, environment: Mapping[str, str], modes: ModesLeft) -> FlightKeeper | None:
    """Return the keeper in the folder that systemd gives the service for its state; None without one."""
    folder = environment.get("STATE_DIRECTORY", "").split(":")[0]
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return None
    return FlightKeeper(Path(folder) / "flight", pilot, vehicle, boot, modes) if folder else None


_REPORTS_MAX = 64
"""Reports of the ship that may wait; the oldest is dropped."""


class CountedPart(Protocol):
    """A part that listens beside the flight and counts."""

    async def run(self) -> None: ...
    def counted(self) -> Mapping[str, float]: ...


if TYPE_CHECKING:  # the dialect is large, and an AR.Drone without a bridge does not need it
    from companion.parts.mavlink.camera_component import Send, ShowCamera
    from drivers.mavlink.links import Tap


def make_daemon(
    settings: Settings,
    pilot: Pilot,
    *,
    clock: Clock | None = None,
    observers: Sequence[Observer] = (),
    once: bool = False,
    settings_file: Path | None = None,
    log_counts: Callable[[], Mapping[str, float]] | None = None,
) -> Daemon:
    """Return a daemon around the pilot, with the vehicle and the links of the settings.

    Args:
        settings_file: the file that the settings were read from, for the page; None if there is none.
        log_counts: returns the counters of the log, for health.

    Raises:
        BadInput: a secret, certificate or folder that a link needs cannot be read or used.
    """
    ticking = clock or SystemClock()
    health = Health(ticking)
    if log_counts is not None:
        health.counters("log", log_counts)
    watching, extras = list(observers), dict[str, Body]()

    def add(name: str, part: CountedPart) -> None:
        extras[name] = part.run
        health.counters(name, part.counted)

    recording: Callable[[bool], str | None] | None = None
    tap: Tap | None = None
    if settings.recorder.enabled or settings.mqtt.transport != "off" or isinstance(settings.vehicle, AutopilotOptions):
        from companion.parts.recorder.setup import RecorderBeside, recorder_of

        recorder = RecorderBeside(lambda: recorder_of(settings, ticking, health), health)
        watching.append(recorder)
        extras["recorder"] = recorder.run
        recording, tap = recorder.switch, recorder.on_link
    show: ShowCamera | None = None
    if settings.video_stream.to:
        from companion.parts.mavlink.camera_component import CameraComponent
        from companion.parts.video.part import VideoStreamPart

        video = VideoStreamPart(settings.video_stream, pilot, ticking)
        watching.append(video)
        add("video_stream", video)

        def show(send: Send) -> CameraComponent:
            return CameraComponent(send, pilot.camera, settings.video_stream, video.size, lambda: video.flows)

    vehicle = vehicle_parts(settings, pilot, health, ticking, recording, tap, show)
    watching[:0] = vehicle.observers  # the autopilot waits for the pad, and nobody else does
    if isinstance(ticking, SystemClock):
        modes = modes_left if isinstance(settings.vehicle, AutopilotOptions) else no_modes
        if (keeper := keeper_of(pilot, vehicle_name(settings), os.environ, modes)) is not None:
            watching.append(keeper)
    extras |= vehicle.extras
    reports: Line[Sample] | None = None
    vessel, choice = settings.vessel, SourceChoice(log.info)
    streams = [key for key in ("source", "heading") if getattr(settings.rtk, key)]
    if vessel.nmea or vessel.bus or vessel.mqtt or streams:
        from companion.parts.ship.part import BusPart, RtkPart, SentencesPart

        reports = Line(_REPORTS_MAX)
        if vessel.nmea:
            add("sentences", SentencesPart(vessel, choice, reports, ticking))
        if vessel.bus:
            add("bus", BusPart(vessel.bus, vessel.nmea_simulated, choice, reports, ticking))
        for key in streams:
            add(f"rtk_{key}", RtkPart(settings.rtk, key, reports, ticking))
    if sources(settings):
        if settings.guidance.rendezvous.enabled:  # a network without a GNSS receiver is worth its motion sensor all the same
            health.awaited |= {SHIP_PLACE}
        health.counters("ship_place", lambda: pilot.landing.vessel_track.counted())
    if settings.mqtt.transport != "off":
        from companion.parts.mqtt.part import make_mqtt

        ship = reports if settings.vessel.mqtt else None
        mqtt = RestartablePart("mqtt", lambda: make_mqtt(settings.mqtt, pilot, health, ticking, recording, ship))
        watching.append(mqtt)
        extras["mqtt"] = mqtt.run
    if (path := socket_path(settings)) is not None:
        terminals = OperatorSocket(path, pilot, ticking)
        watching.append(terminals)
        add("operator", terminals)
    if settings.operator.gamepad != OFF:
        from companion.parts.operator.gamepad_part import GamepadPart
        from companion.settings.referenced_files import mapping_of

        mapping = mapping_of(settings.operator.gamepad)
        gamepad = GamepadPart(mapping, settings.operator.gamepad_device, pilot, ticking)
        watching.append(gamepad)
        add("gamepad", gamepad)
    if settings.http.endpoint != "off":
        from companion.base.http_server import HttpServer
        from companion.parts.metrics.endpoint import MetricsEndpoint

        server = HttpServer(settings.http, health)
        extras["http"] = server.run
        MetricsEndpoint(server, health)
        if settings.http.foxglove:
            from companion.parts.live.part import FoxgloveEndpoint
            from companion.parts.recorder.setup import wall_offset_ns

            data = FoxgloveEndpoint(server, pilot, health, ticking, vehicle_name(settings), wall_offset_ns(ticking))
            watching.append(data.feed)
            extras["foxglove"] = data.run
        if settings.http.page:
            from companion.parts.page.make import make_page
            from companion.parts.page.viewer import PageService
            from companion.settings.settings_file import SettingsFile

            file = None if settings_file is None else SettingsFile(settings_file)
            service = PageService(server, settings, pilot, health, ticking, vehicle.autopilot, file)
            page = make_page(service, vehicle_name(settings))
            watching.append(page)
            extras["page"] = page.run
    if (pulse := _pulse(pilot, health, ticking)) is not None:
        watching.append(pulse)
        extras["manager"] = pulse.run
    if isinstance(ticking, SystemClock):
        stands = PilotOperator(pilot, OrderSender(OrderSource.LIMITS, "(the service stood still)"), ticking)
        extras["loop"] = LoopWatch(health, partial(_flies, pilot), partial(stands.order, OperatorOrder.HOLD)).run

    return Daemon(
        vehicle.open_link,
        pilot,
        ticking,
        DaemonSetup(
            settings.service,
            settings.guidance.rate_hz,
            health_period_s=settings.service.health_period_s,
            threads=settings.vision.threads,
            core_fraction=settings.vision.core_fraction,
            once=once,
            prepare=partial(_prepare, pilot),
        ),
        observers=watching,
        health=health,
        extras=extras,
        reports=reports,
    )


def vehicle_name(settings: Settings) -> str:
    """Return the vehicle's name for a person."""
    v = settings.vehicle
    return f"autopilot on {v.links}" if isinstance(v, AutopilotOptions) else f"AR.Drone at {v.host}"


def _prepare(pilot: Pilot) -> None:
    """Do before the first frame what would delay it."""
    pilot.search.rehearse()
    memory.give_back()


def _pulse(pilot: Pilot, health: Health, clock: Clock) -> Pulse | None:
    """Return the systemd observer, or None. A wrong environment is only logged: it is no setting and must not stop us."""
    try:
        interval_s, manager = watchdog_interval_s(), Manager.of()
    except BadInput as why:
        log.error("%s; the service manager is not notified", why)
        return None
    if manager is None:
        return None
    return Pulse(manager, health, clock, partial(_flies, pilot), interval_s)


def _flies(pilot: Pilot) -> bool:
    """Return whether the vehicle flew by its newest status."""
    return pilot.vehicle is not None and bool(pilot.vehicle.flying)


async def live(daemon: Daemon, pilot: Pilot, *, stays: bool = False) -> FlightOutcome | None:
    """Run the daemon, and heed signals.

    SIGINT and SIGTERM end it in order: the vehicle holds, recordings are closed. SIGQUIT does the same after the log
    has each thread's stack. SIGUSR1 begins (or resumes) the approach, SIGUSR2 holds it. Python ignores SIGPIPE: the write fails.

    Args:
        stays: a terminal that hangs up (SIGHUP) or Ctrl-Z (SIGTSTP) is logged and not followed: a drone in the air cannot
            be put aside. SIGTTIN and SIGTTOU, which stop a job in the background that uses its terminal, are ignored.
    """
    operator = PilotOperator(pilot, OrderSender(OrderSource.SIGNAL), SystemClock())

    def quit_() -> None:
        for line in threads():
            log.warning("thread %s", line)
        daemon.stop()

    def end() -> None:
        status = pilot.vehicle
        flying = None if status is None else status.flying
        hovers = "in the air: it hovers, unless a person or a mode of its own flies it"
        left = hovers if flying else "on the ground" if flying is False else "as it is: it sends no status"
        log.info("SIGTERM ends the service and leaves the vehicle %s", left)
        daemon.stop()

    handlers: dict[signal.Signals, Callable[[], object]] = {
        signal.SIGINT: daemon.stop,
        signal.SIGTERM: end,
        signal.SIGQUIT: quit_,
        signal.SIGUSR1: lambda: operator.order(OperatorOrder.BEGIN),
        signal.SIGUSR2: lambda: operator.order(OperatorOrder.HOLD),
    }
    if stays and PROCESS.heeding:
        handlers |= {
            signal.SIGHUP: partial(log.warning, "the terminal hung up (SIGHUP): the service goes on; SIGTERM ends it"),
            signal.SIGTSTP: partial(log.warning, "Ctrl-Z (SIGTSTP) is not followed: the service goes on; Ctrl-C ends it"),
        }
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)
        signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    with heeded(handlers):
        return await daemon.run()
