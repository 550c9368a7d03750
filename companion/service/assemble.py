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

from companion.base import memory
from companion.base.containment import RESTART
from companion.base.event_loop import heeded
from companion.base.health import SHIP_PLACE, Health
from companion.base.mission import FlightOutcome
from companion.base.observer import NullObserver, Observer, ProcessedFrame
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.base.signals import PROCESS, threads
from companion.cycle.ports import Assembly
from companion.guidance.pilot import Pilot
from companion.guidance.pilot_operator import PilotOperator
from companion.service.daemon import Daemon, DaemonSetup
from companion.service.parts import join_all
from companion.settings import schema
from companion.settings.model import Settings
from companion.settings.remarks import sources
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput, DecklanderError, Recoverable, in_words
from estimator.contracts.time import Clock

log = logging.getLogger(__name__)

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


def make_daemon(
    settings: Settings,
    pilot: Pilot,
    *,
    clock: Clock | None = None,
    observers: Sequence[Observer] = (),
    once: bool = False,
    settings_file: Path | None = None,
    log_counts: Callable[[], Mapping[str, float]] | None = None,
    health: Health | None = None,
) -> Daemon:
    """Return a daemon around the pilot, with the vehicle and the parts of the settings.

    Args:
        settings_file: the file that the settings were read from, for the page; None if there is none.
        log_counts: returns the counters of the log, for health.
        health: the health that is shared with what was made before; if absent, a new one is made.

    Raises:
        BadInput: a secret, certificate or folder that a part needs cannot be read or used.
    """
    ticking = clock or SystemClock()
    health = health or Health(ticking)
    if log_counts is not None:
        health.counters("log", log_counts)
    if sources(settings):
        if settings.guidance.rendezvous.enabled:  # a network without a GNSS receiver is worth its motion sensor all the same
            health.awaited |= {SHIP_PLACE}
        health.counters("ship_place", lambda: pilot.landing.vessel_track.counted())
    service = Assembly(settings, pilot, health, ticking, settings_file, list(observers))
    join_all(service)
    assert service.vehicle is not None
    return Daemon(
        service.vehicle.open_link,
        pilot,
        ticking,
        DaemonSetup(
            RESTART,
            settings.guidance.rate_hz,
            health_period_s=settings.service.health_period_s,
            threads=settings.vision.threads,
            core_fraction=settings.vision.core_fraction,
            once=once,
            prepare=partial(_prepare, pilot),
        ),
        observers=service.observers,
        health=health,
        extras=service.extras,
        reports=service.reports,
    )


def _prepare(pilot: Pilot) -> None:
    """Do before the first frame what would delay it."""
    pilot.search.rehearse()
    memory.give_back()


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
