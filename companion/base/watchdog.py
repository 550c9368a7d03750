"""Notify systemd whether the pipeline is alive.

Alive is a pipeline whose guidance decides and uses its inputs, not a process that runs. systemd is notified that the service is
ready, that its pipeline is alive, and that it ends (sd_notify, without libsystemd). The guidance cycles feed the watchdog, never
a timer of its own: if a cycle does not come, if vision does not return a frame, or if a flying vehicle sends no more samples, the
pings end and systemd restarts the service. Source: sd_notify(3), sd_watchdog_enabled(3).
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket
from collections.abc import Callable, Mapping

from companion.base.health import Health, HealthSnapshot, missing_inputs
from companion.base.observer import Decision, NullObserver
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import Clock, MonoNs, seconds_between

log = logging.getLogger(__name__)

SAMPLE_KINDS = ("Attitude", "Imu", "BodyVelocity", "VehicleStatus")
"""Flows that keep arriving while the vehicle is in reach."""

GUIDANCE_S = 1.0
"""Time between two guidance cycles that counts as stuck."""
FRAME_S = 3.0
"""Time of vision on one frame that counts as stuck."""
SAMPLES_S = 10.0
"""Time without a sample from a vehicle that last reported flying that counts as stuck. A landed or unknown vehicle may be off."""
_EVERY = 4
"""Number of pings within one watchdog interval: systemd requests two, and a guidance cycle may be late."""
_STATUS_S = 1.0
"""Time between two status lines if there is no watchdog, seconds."""


def _frame_held_s(health: HealthSnapshot) -> float | None:
    """Return how long vision has a frame already that is not done; None while that is not too long."""
    frames = health.flows.get("Frame")
    if frames is None or frames.age_s is None or frames.age_s <= FRAME_S:
        return None
    done = sum(n for verdict, n in health.frames.items() if verdict != Verdict.REPLACED.value)
    return frames.age_s if frames.count > done else None


def stuck(health: HealthSnapshot, flying: bool) -> str | None:
    """Return why the pipeline is not alive, as text; None while it is.

    Args:
        flying: whether the vehicle flew according to its latest status.
    """
    decided = health.flows.get("Decision")
    age_s = None if decided is None else decided.age_s
    if age_s is None:
        return "guidance has not begun"
    if age_s > GUIDANCE_S:
        return f"guidance has decided nothing for {age_s:.1f} s"
    if (held_s := _frame_held_s(health)) is not None:
        return f"vision has not been done with a frame for {held_s:.1f} s"
    flows: Mapping[str, float | None] = {kind: health.flows[kind].age_s for kind in SAMPLE_KINDS if kind in health.flows}
    ages = [age for age in flows.values() if age is not None]
    silence_s = min(ages) if ages else None
    if flying and silence_s is not None and silence_s > SAMPLES_S:
        return f"no sample of the flying vehicle for {silence_s:.1f} s"
    return None


class Manager:
    """The service manager's socket. Datagrams that it does not accept are lost: a service must not wait for its manager.

    Raises:
        BadInput: `address` is not the address of a unix socket.
    """

    def __init__(self, address: str) -> None:
        if not address.startswith(("/", "@")):
            raise BadInput(f"$NOTIFY_SOCKET: {address[:60]!r} is not the address of a unix socket")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.setblocking(False)
        self.lost = 0

    @staticmethod
    def of(environment: Mapping[str, str] = os.environ) -> Manager | None:
        """Return the manager that started us; None if the environment names none."""
        address = environment.get("NOTIFY_SOCKET")
        return Manager(address) if address else None

    def say(self, **fields: str) -> None:
        """Send one datagram of NAME=value lines."""
        text = "\n".join(f"{name}={' '.join(value.split())}" for name, value in fields.items())
        try:
            self._socket.sendto(text.encode(), self._address)
        except OSError as why:
            self.lost += 1
            log.debug("the service manager did not take %s: %s", next(iter(fields), ""), why)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Pulse(NullObserver):
    """An observer that turns guidance cycles into READY=1, WATCHDOG=1 and a status line.

    Args:
        flying: returns whether the vehicle flew according to its latest status.
        interval_s: the watchdog's interval, seconds; None if there is no watchdog.
    """

    def __init__(
        self, manager: Manager, health: Health, clock: Clock, flying: Callable[[], bool], interval_s: float | None
    ) -> None:
        self._manager = manager
        self._health = health
        self._clock = clock
        self._flying = flying
        self._watched = interval_s is not None
        self._period_s = _STATUS_S if interval_s is None else interval_s / _EVERY
        self._last: MonoNs | None = None
        self._last_reason = ""
        self.pings = 0
        """Number of times that the pipeline was found alive."""

    def on_decision(self, decision: Decision) -> None:
        now = self._clock.now()
        if self._last is not None and seconds_between(self._last, now) < self._period_s:
            return
        health = self._health.snapshot()
        why = stuck(health, self._flying())
        if why is not None:
            if why.partition(" for ")[0] != self._last_reason:
                self._last_reason = why.partition(" for ")[0]
                log.error("%s: the watchdog is not fed", why)
            self._manager.say(STATUS=why)
            self._last = now
            return
        self._last_reason = ""
        rates = (health.flows.get(kind) for kind in ("Frame", "Imu"))
        frames, samples = (0.0 if flow is None or flow.rate_hz is None else flow.rate_hz for flow in rates)
        phase = ": ".join(filter(None, (decision.phase, ", ".join(missing_inputs(health)), health.too_slow)))
        fields = {"STATUS": f"{phase}; {frames:.0f} frames and {samples:.0f} inertial samples a second"}
        if self.pings == 0:
            fields["READY"] = "1"
        if self._watched:
            fields["WATCHDOG"] = "1"
        self._manager.say(**fields)
        self._last = now
        self.pings += 1

    async def run(self) -> None:
        """Wait until cancelled, then notify the manager that the service ends."""
        try:
            await asyncio.Event().wait()
        finally:
            self._manager.say(STOPPING="1", STATUS="ending")
            self._manager.close()


def watchdog_interval_s(environment: Mapping[str, str] = os.environ, pid: int | None = None) -> float | None:
    """Return the watchdog interval that systemd set for this process, seconds; None if it set none.

    Raises:
        BadInput: $WATCHDOG_USEC is not a positive whole number.
    """
    text = environment.get("WATCHDOG_USEC")
    if not text or environment.get("WATCHDOG_PID", str(pid or os.getpid())) != str(pid or os.getpid()):
        return None
    if not text.isascii() or not text.isdigit() or int(text) == 0:
        raise BadInput(f"$WATCHDOG_USEC: {text[:40]!r} is not a positive number of microseconds")
    return int(text) * 1e-6
