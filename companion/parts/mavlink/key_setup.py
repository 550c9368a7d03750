"""Give an autopilot a signing key or take it away, and check whether the autopilot applied the change.

    found = await meet(endpoint, current, system, clock, seconds)
    await send_key(endpoint, current, found, key, clock)
    signs = await observe(endpoint, key, found, clock, seconds)

Source: mavlink.io, "Message signing", SETUP_SIGNING.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from drivers.endpoint import Endpoint
from drivers.mavlink.access import NamedSenders
from drivers.mavlink.dialect import TimeSyncV2, mav
from drivers.mavlink.links import LinkOptions, Links, ReceivedMessage, open_links
from drivers.mavlink.options import LinkLimits
from drivers.mavlink.signing import Signing, SigningKey, SigningTimes
from drivers.mavlink.vehicle import ARMED, is_autopilot, stack_of
from estimator.contracts.errors import Recoverable
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between

VERSION_2_CURE = "set SERIALn_PROTOCOL 2 (ArduPilot) or MAV_PROTO_VER 2 (PX4) for this link"
_STATION = (255, 190)
_KNOCK_S = 0.3
_REPEATS = 3
_CHANGES_OVER_S = 3.0
"""Time for which a heartbeat in MAVLink 1 may be followed by one in 2: an autopilot may switch when it receives MAVLink 2."""
_NO_KEY = [0] * 32


@dataclass(frozen=True, slots=True)
class Met:
    """An autopilot from which a heartbeat was received."""

    system: int
    component: int
    stack: str
    armed: bool
    signs: bool
    """True if the autopilot's messages are signed, by whatever key."""
    old_version: bool
    """True if it uses MAVLink 1 even towards MAVLink 2 peers: such messages carry no signature."""


async def meet(endpoint: Endpoint, current: SigningKey | None, system: int | None, clock: Clock, seconds: float) -> Met:
    """Return the first autopilot whose heartbeat is received on the link.

    Args:
        current: the key that the link is already signed with; None if it is not signed.
        system: the system id of the autopilot; None for the first one.
        seconds: how long to listen.

    Raises:
        Recoverable: no heartbeat was received.
    """
    met: Met | None = None
    async with _opened(endpoint, current, clock) as links:
        first: MonoNs | None = None
        try:
            async with asyncio.timeout(seconds):
                async for received in links.received:
                    message = received.message
                    if message.get_type() != "HEARTBEAT" or system not in (None, received.system):
                        continue
                    if is_autopilot(message, received.component):
                        armed = bool(message.base_mode & ARMED)
                        met = Met(
                            received.system, received.component, stack_of(message).value, armed, _is_signed(received),
                            _is_old_version(received),
                        )  # fmt: skip
                        first = clock.now() if first is None else first
                        if not met.old_version or seconds_between(first, clock.now()) > _CHANGES_OVER_S:
                            return met
        except TimeoutError:
            pass
        if met is None:
            raise Recoverable(_silence(links, endpoint, current))
    return met


async def send_key(endpoint: Endpoint, current: SigningKey | None, to: Met, key: SigningKey | None, clock: Clock) -> None:
    """Send SETUP_SIGNING; without a key, signing is taken away."""
    secret, time = (_NO_KEY, 0) if key is None else (list(key.secret), SigningTimes(None).next())
    async with _opened(endpoint, current, clock) as links:
        for _ in range(_REPEATS):
            links.send(mav.MAVLink_setup_signing_message(to.system, to.component, secret, time))
            await clock.sleep(_KNOCK_S)


async def observe(endpoint: Endpoint, key: SigningKey | None, of: Met, clock: Clock, seconds: float) -> bool:
    """Return whether the autopilot now signs with this key; without a key, whether it signs no more."""
    async with _opened(endpoint, key, clock) as links:
        try:
            async with asyncio.timeout(seconds):
                async for received in links.received:
                    if (received.system, received.component) == (of.system, of.component) and _is_signed(received) is (
                        key is not None
                    ):
                        return True
        except TimeoutError:
            pass
    return False


@asynccontextmanager
async def _opened(endpoint: Endpoint, key: SigningKey | None, clock: Clock) -> AsyncIterator[Links]:
    signing = None if key is None else Signing(key, SigningTimes(None), 0)
    options = LinkOptions(endpoint, signing, LinkLimits(restart_first_s=0.1, restart_most_s=0.5))
    # Every sender on this link is trusted, because a person stated that the link leads to the autopilot.
    async with (
        open_links([options], clock, _STATION, access=NamedSenders(everybody=True)) as links,
        asyncio.TaskGroup() as group,
    ):
        probing = group.create_task(_probe(links, clock))
        try:
            yield links
        finally:
            probing.cancel()


async def _probe(links: Links, clock: Clock) -> None:
    while True:
        links.send(TimeSyncV2(0, clock.now()))
        await clock.sleep(_KNOCK_S)


def _is_signed(received: ReceivedMessage) -> bool:
    """Return whether the frame's flags mark it as signed; no key is needed to read them."""
    frame = received.message.get_msgbuf()
    return frame[0] == mav.PROTOCOL_MARKER_V2 and bool(frame[2] & mav.MAVLINK_IFLAG_SIGNED)


def _is_old_version(received: ReceivedMessage) -> bool:
    return bool(received.message.get_msgbuf()[0] == mav.PROTOCOL_MARKER_V1)


def _silence(links: Links, endpoint: Endpoint, current: SigningKey | None) -> str:
    link = links.all[0]
    if link.down is not None:
        return f"{endpoint} is not open: {link.down}"
    if link.counters.total("old_version"):
        return f"{endpoint}: what comes is MAVLink 1, which carries no signature; {VERSION_2_CURE}"
    if link.counters.total("refused_signature"):
        return f"{endpoint}: what comes is not signed with the key in --current"
    if link.counters.total("messages"):
        return f"{endpoint}: MAVLink, but no autopilot of a copter"
    return f"{endpoint}: no autopilot is connected" + ("" if current is None else " that signs with the key in --current")
