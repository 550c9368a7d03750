"""Keep what the service knows of its flight in a file, beside the flight, for the service that comes after it."""

import logging
import os
from collections.abc import Mapping
from pathlib import Path

import msgspec
from msgspec import Struct, structs

from companion.base.observer import Decision, NullObserver
from companion.base.worker import Worker
from companion.cycle.ports import Assembly
from companion.guidance.flight_memory import FlightMemory
from companion.guidance.pilot import Pilot
from drivers.clock import SystemClock
from drivers.vehicle import VehicleOptions
from estimator.contracts.time import MonoNs, seconds_between

log = logging.getLogger(__name__)

_EACH_S = 0.5
"""Time between two records, s; a change of state is written at once."""
_LONGEST = 4096
"""Most bytes that are read."""


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
        vehicle: the vehicle; the memory of another one is not used.
        boot: a word for this start of the computer.
    """

    def __init__(self, path: Path, pilot: Pilot, vehicle: VehicleOptions, boot: str) -> None:
        self._path, self._pilot, self._vehicle, self._boot = path, pilot, vehicle, boot
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
        return kept.memory if (kept.boot, kept.vehicle) == (self._boot, self._vehicle.name) else None

    def on_decision(self, decision: Decision) -> None:
        """Write the memory where it is due and the write before has ended."""
        due = self._written is None or seconds_between(self._written, decision.at) >= _EACH_S or decision.transitions
        memory = self._pilot.landing.memory
        if not due or memory is None or self._writer.busy:
            return
        self._written = decision.at
        if (status := self._pilot.landing.vehicle) is not None:
            memory = structs.replace(memory, modes=self._vehicle.modes_left(status.mode))
        text = msgspec.json.encode(FlightRecord(self._boot, self._vehicle.name, memory))
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


def keeper_of(pilot: Pilot, vehicle: VehicleOptions, environment: Mapping[str, str]) -> FlightKeeper | None:
    """Return the keeper in the folder that systemd gives the service for its state; None without one."""
    folder = environment.get("STATE_DIRECTORY", "").split(":")[0]
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return None
    return FlightKeeper(Path(folder) / "flight", pilot, vehicle, boot) if folder else None


def join(service: Assembly) -> None:
    """Add the keeper, in real time and where there is a folder for it."""
    if not isinstance(service.clock, SystemClock):
        return
    if (keeper := keeper_of(service.pilot, service.settings.vehicle, os.environ)) is not None:
        service.observers.append(keeper)
