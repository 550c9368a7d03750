"""Take a snapshot of an autopilot over its links. It judges nothing and changes nothing."""

from collections.abc import Callable, Sequence

from msgspec import structs

from companion.tools.doctor import rules_switch
from companion.tools.doctor.diagnose import PARAMETERS
from companion.tools.doctor.firmware_parameters import defaults_of, differing, earlier_names, names_in
from companion.tools.doctor.listening import Notes, snapshot_of
from companion.tools.doctor.snapshot import GimbalSnapshot, Snapshot
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.dialect import mav
from drivers.mavlink.gimbal import Gimbal, tending
from drivers.mavlink.links import LinkOptions
from drivers.mavlink.options import AutopilotOptions, GimbalOptions
from drivers.mavlink.rc_channels import RATE_HZ
from estimator.contracts.time import Clock, MonoNs, seconds_between

_REQUESTS_MAX_S = 30.0  # longest wait for streams and parameters
_VERSION_S = 1.0  # longest wait for the version
_FIRST_ANSWER_S = 5.0
"""Time after which an autopilot that answered nothing at all is not waited for, seconds."""
_POLL_S = 0.05  # interval at which a wait is checked
_RESTS_S = 3.0
"""Time without a move after which a switch counts as tried, seconds."""

Say = Callable[[str], None]


async def examine(
    options: AutopilotOptions,
    clock: Clock,
    seconds: float,
    say: Say = lambda text: None,
    links: Sequence[LinkOptions] | None = None,
    gimbal: GimbalOptions | None = None,
    channel: int = 0,
) -> Snapshot:
    """Listen to the links, query the autopilot, and return the snapshot.

    Args:
        seconds: how long to wait for an autopilot, and again how long to count its messages.
        say: called with a progress line for a terminal.
        links: the links of the options with their keys; None for those of the options without any key.
        gimbal: the camera's gimbal, whose reports are requested and which is left where it points; None without one.
        channel: channel of the transmitter's switch; 0 without one.
    """
    notes = Notes()
    began = clock.now()
    found = None if gimbal is None or not gimbal.given else Gimbal(structs.replace(gimbal, point_down=False), clock)
    async with open_autopilot(options, clock, links) as autopilot, tending(found, autopilot, clock):
        autopilot.add_listener(notes.on_message)
        say(f"listening on {', '.join(str(link.endpoint) for link in autopilot.links.all)}")
        await wait_until(clock, seconds, lambda: autopilot.connected)
        rates: dict[str, float] = {}
        if autopilot.identity is not None:
            rates = await _ask(autopilot, notes, clock, seconds, say, channel)
        snapshot = _compared(snapshot_of(autopilot, notes, rates, options.system_id, seconds_between(began, clock.now())))
        if found is None or snapshot.autopilot is None:
            return snapshot
        return structs.replace(snapshot, gimbal=GimbalSnapshot(found.device_id, found.rate_hz, dict(found.sampler.refused)))


async def examine_open(autopilot: Autopilot, wanted: int, clock: Clock, seconds: float, channel: int = 0) -> Snapshot:
    """Examine the autopilot over the links that a service has open; cancelled, it sends nothing more.

    The links' counters are those since they were opened; texts and events are those of this examination.

    Args:
        wanted: the system id that the settings request; 0 for any.
        seconds: how long to count messages.
    """
    notes, began, events = Notes(), clock.now(), autopilot.counts["EVENT"]
    autopilot.add_listener(notes.on_message)
    try:
        rates: dict[str, float] = {}
        if autopilot.identity is None:
            await clock.sleep(seconds)
        else:
            rates = await _ask(autopilot, notes, clock, seconds, lambda text: None, channel)
        snapshot = _compared(snapshot_of(autopilot, notes, rates, wanted, seconds_between(began, clock.now())))
    finally:
        autopilot.remove_listener(notes.on_message)
        if autopilot.parameters is not None:
            autopilot.parameters.forget()
    if snapshot.autopilot is None:
        return snapshot
    texts = tuple(text for at, _, text in autopilot.texts if at >= began)
    newer = min(autopilot.counts["EVENT"] - events, len(autopilot.events))
    numbers = tuple(autopilot.events)[len(autopilot.events) - newer :]
    return structs.replace(snapshot, autopilot=structs.replace(snapshot.autopilot, texts=texts, events=numbers))


def _compared(snapshot: Snapshot) -> Snapshot:
    """Return a snapshot with what differs from the firmware's defaults."""
    a = snapshot.autopilot
    if a is None:
        return snapshot
    differs = differing(a.parameters, defaults_of(a.stack, a.firmware, a.parameters))
    return structs.replace(snapshot, autopilot=structs.replace(a, differs=differs))


async def seen_moving(options: AutopilotOptions, clock: Clock, seconds: float) -> dict[int, dict[str, int]] | None:
    """Watch the transmitter until one of its switches has moved and rested, and return the channels that moved, as in a snapshot.

    Args:
        seconds: how long to wait for that.

    Returns:
        None where no RC_CHANNELS arrives.
    """
    notes, began, rests = Notes(), clock.now(), clock.now()
    async with open_autopilot(options, clock) as autopilot:
        autopilot.add_listener(notes.on_message)
        known = notes.moved()
        while seconds_between(began, clock.now()) < seconds and not (known and seconds_between(rests, clock.now()) > _RESTS_S):
            await clock.sleep(_POLL_S)
            if autopilot.streams is not None:
                autopilot.streams.also("RC_CHANNELS", RATE_HZ)
            if known.keys() != (now := notes.moved()).keys() or any(list(known[n]) != list(now[n]) for n in known):
                known, rests = {channel: dict(stood) for channel, stood in now.items()}, clock.now()
        return known if autopilot.counts["RC_CHANNELS"] else None


async def _ask(autopilot: Autopilot, notes: Notes, clock: Clock, seconds: float, say: Say, channel: int) -> dict[str, float]:
    identity, parameters, streams = autopilot.identity, autopilot.parameters, autopilot.streams
    assert identity is not None
    assert parameters is not None
    assert streams is not None
    say(f"{identity.stack.value}, system {identity.system}: reading parameters, asking for streams")
    await wait_until(clock, _VERSION_S, lambda: autopilot.version is not None)
    firmware = None if autopilot.version is None else autopilot.version.firmware
    known = defaults_of(identity.stack.value, firmware)
    names = names_in(PARAMETERS[identity.stack.value], firmware)
    if channel:
        streams.also("RC_CHANNELS", RATE_HZ)
        names = (*names, *rules_switch.parameters(identity.stack.value, channel))
    parameters.request(dict.fromkeys((*names, *known)))

    def answered() -> bool:
        found = bool(parameters.values) or autopilot.counts["COMMAND_ACK"] > 0
        return found or (autopilot.sync is not None and autopilot.sync.round_trip_s is not None)

    await wait_until(clock, _FIRST_ANSWER_S, answered)
    if answered():
        await wait_until(clock, _REQUESTS_MAX_S, lambda: parameters.settled and streams.settled)
        parameters.request(earlier_names(parameters.absent))
        await wait_until(clock, _REQUESTS_MAX_S, lambda: parameters.settled)
    if autopilot.condition.armed is False:
        check = mav.MAV_CMD_RUN_PREARM_CHECKS
        autopilot.send(mav.MAVLink_command_long_message(*identity.address, check, 0, 0, 0, 0, 0, 0, 0, 0))
    say("counting messages")
    before, since = autopilot.counts.copy(), clock.now()
    await clock.sleep(seconds)
    lasted_s = max(seconds_between(since, clock.now()), 1e-3)
    return {name: (n - before[name]) / lasted_s for name, n in autopilot.counts.items() if n > before[name]}


async def wait_until(clock: Clock, seconds: float, done: Callable[[], bool]) -> None:
    """Return as soon as `done`, or after this many seconds."""
    began: MonoNs = clock.now()
    while not done() and seconds_between(began, clock.now()) < seconds:
        await clock.sleep(_POLL_S)
