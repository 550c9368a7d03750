"""`decklander replay --realtime`: replay a recording at its own pace and send the outputs over MAVLink."""

from __future__ import annotations

import argparse
import asyncio
import sys
from contextlib import AsyncExitStack

from companion.base import event_loop
from companion.base.observer import Decision, NullObserver, Observer
from companion.cli.progress import ProgressObserver
from companion.guidance.pilot import Pilot
from companion.parts.mavlink import operator
from companion.parts.mavlink.component import Component, ComponentOptions, speaking
from companion.recording.reading import Recording
from companion.settings.load import Settings
from companion.tools.replay.engine import Replay
from companion.tools.replay.pilots import pilot_of
from drivers.clock import SystemClock
from drivers.mavlink.autopilot import open_autopilot
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import PathName, RelativeState
from estimator.contracts.time import MonoNs, seconds_between

_REFUSAL = "this is a replay: it takes no commands"
_LEAD_S = 0.05
"""Time from the beginning of the replay to its first event, s."""


class _Deaf:
    """An operator that refuses every command."""

    def begin(self) -> str | None:
        return _REFUSAL

    def pause(self) -> str | None:
        return _REFUSAL

    def abort(self) -> str | None:
        return _REFUSAL

    def choose_path(self, path: PathName) -> str | None:
        return f"{_REFUSAL}, not even of {path}"

    def record(self, on: bool) -> str | None:
        return _REFUSAL if on else None

    def progress(self) -> operator.LandingProgress:
        return operator.LandingProgress(None)


class _Newest(NullObserver):
    """An observer that keeps the newest estimate of guidance."""

    belief: RelativeState | None = None

    def on_decision(self, decision: Decision) -> None:
        self.belief = decision.belief

    def at(self, now: MonoNs) -> RelativeState | None:
        """Return the newest estimate, at most one guidance cycle old."""
        return self.belief


def play(args: argparse.Namespace, recording: Recording, settings: Settings) -> int:
    """Replay to the end of the recording; return exit code 0.

    Raises:
        BadInput: a MAVLink address that is none.
    """
    pilot = pilot_of(recording, settings, args.path, own_camera=args.config is None, alone=True)
    return event_loop.run(_play(args, recording, settings, pilot))


async def _play(args: argparse.Namespace, recording: Recording, settings: Settings, pilot: Pilot) -> int:
    clock = SystemClock()
    newest = _Newest()
    observers: list[Observer] = [newest]
    progress = None if args.json else ProgressObserver()
    async with AsyncExitStack() as stack:
        if args.mavlink:
            vehicle = _autopilot(args.mavlink)
            options = ComponentOptions(pilot.pad.disc_radius_m, settings.guidance.stale_after_s, settings.landing_target)
            component = Component(options, _Deaf(), None, healthy=lambda: None, believe=newest.at, clock=clock)
            autopilot = await stack.enter_async_context(open_autopilot(vehicle, clock))
            await stack.enter_async_context(speaking(component, autopilot, clock))
            observers.append(component)
        if progress is not None:
            observers.append(progress)
        late_s = await _paced(args, recording, settings, pilot, observers, clock)
    if progress is not None:
        progress.close()
    sys.stdout.write(f"played to the end; {1e3 * late_s:.0f} ms late at most\n")
    return 0


def _autopilot(urls: list[str]) -> AutopilotOptions:
    try:
        return AutopilotOptions(", ".join(urls))
    except ValueError as why:
        raise BadInput(str(why).replace("links:", "--mavlink:", 1)) from why


async def _paced(
    args: argparse.Namespace,
    recording: Recording,
    settings: Settings,
    pilot: Pilot,
    observers: list[Observer],
    clock: SystemClock,
) -> float:
    """Replay at the pace of the recording; return the largest delay, seconds."""
    first = _first_instant(recording, pilot)
    start = clock.now()
    shift_ns = start - first + round(_LEAD_S * 1e9)
    replay = Replay(
        recording,
        pilot,
        sightings=args.sightings,
        rate_hz=settings.guidance.rate_hz,
        shift_ns=shift_ns,
        observers=observers,
    )
    late_s = 0.0
    for at, _ in replay.steps():
        ahead_s = seconds_between(clock.now(), at)
        if ahead_s > 0.001:
            await clock.sleep(ahead_s)
        else:
            late_s = max(late_s, -ahead_s)
            await asyncio.sleep(0)
    return late_s


def _first_instant(recording: Recording, pilot: Pilot) -> MonoNs:
    for at, _ in Replay(recording, pilot).steps():
        return at
    return MonoNs(0)
