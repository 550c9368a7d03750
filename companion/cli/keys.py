"""`decklander keys`: make and show MAVLink signing keys, install and remove them on an autopilot; make a page's token."""

from __future__ import annotations

import argparse
import asyncio
import logging
import os
import secrets
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from msgspec import Struct

from companion.cli.options import named_wait, option
from companion.cli.outputs import SECRET, output
from companion.parts.page.access import make_token
from companion.settings.files import signing_key
from drivers.clock import SystemClock
from drivers.endpoint import Endpoint, parse_endpoint
from drivers.mavlink.access import NamedSenders
from drivers.mavlink.dialect import TimeSyncV2, mav
from drivers.mavlink.links import LinkOptions, Links, ReceivedMessage, open_links
from drivers.mavlink.options import LinkLimits
from drivers.mavlink.signing import Signing, SigningKey, SigningTimes
from drivers.mavlink.vehicle import ARMED, is_autopilot, stack_of
from estimator.contracts.errors import BadInput, Recoverable, refused
from estimator.contracts.time import Clock, MonoNs, seconds_between

DESCRIPTION = (
    "Make, show, install and remove MAVLink signing keys (docs/mavlink.md). Exit code 0 if the autopilot "
    "was seen to take the change, 1 if not."
)
_PROBE_S = 0.3  # interval of messages to an autopilot that is looked for
_REPEATS = 3  # times that a key is sent, as its message is not answered
_CHANGES_OVER_S = 3.0
"""Time for which a heartbeat in MAVLink 1 may be followed by one in 2: an autopilot may switch when it receives MAVLink 2."""
_NO_KEY = [0] * 32


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    make = actions.add_parser("make", help="write a new key of 32 random bytes, readable by you alone; never overwrite a file")
    output(make, "file FILE", "key file to write", SECRET)
    token = actions.add_parser("token", help="write a token for the operator page, readable by you alone; never overwrite a file")
    output(token, "file FILE", "token file to write", SECRET)
    show = actions.add_parser("show", help="print the fingerprint of a key, never the key")
    option(show, "file FILE", "key file: 32 bytes, 64 hexadecimal digits, or a line 'passphrase: ...'")
    install = actions.add_parser("install", help="install a key on the autopilot of a link (SETUP_SIGNING)")
    option(install, "file FILE", "key file")
    remove = actions.add_parser("remove", help="remove the key from the autopilot of a link")
    for action in (install, remove):
        option(
            action,
            "--link URL",
            "MAVLink link: serial:///dev/NAME:BAUD (best, since the key crosses the link in clear), "
            "udpin://ADDRESS:PORT, udpout://HOST:PORT, tcp://HOST:PORT",
            required=True,
        )
        option(action, "--current FILE", "key that the autopilot has now, if any")
        option(action, "--system N", "system id of the autopilot", type=int)
        option(action, "--seconds S", "listen this long for the autopilot (default: 5)", default=5.0)
        option(action, "--yes", "do not ask for confirmation")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    logging.basicConfig(level=logging.ERROR)  # the result reports the link's state
    if (made := {"make": _make, "token": _make_token}.get(args.action)) is not None:
        return made(Path(args.file))
    if args.action == "show":
        sys.stdout.write(f"{args.file}: fingerprint {signing_key(args.file).fingerprint}\n")
        return 0
    if not 0.5 <= args.seconds <= 600:
        raise BadInput(f"--seconds must lie in 0.5..600, got {args.seconds:g}")
    if args.system is not None and not 1 <= args.system <= 255:
        raise BadInput(f"--system must lie in 1..255, got {args.system}")
    current = None if args.current is None else signing_key(args.current)
    key = signing_key(args.file) if args.action == "install" else None
    return asyncio.run(_set_up(args, parse_endpoint(args.link), current, key))


def _make(path: Path) -> int:
    key = SigningKey(secrets.token_bytes(32))
    write_secret(path, key.secret)
    sys.stdout.write(
        f"{path}: a new key, fingerprint {key.fingerprint}\n"
        f'next, to sign MAVLink: decklander keys install --link URL {path}; then signing_key_file = "{path}" under [vehicle]\n'
        f'or, to sign orders over MQTT: commands = "signed" and command_key_file = "{path}" under [mqtt], not in the autopilot\n'
        "keep a copy, and a key of its own for each of the two\n"
    )
    return 0


def _make_token(path: Path) -> int:
    write_secret(path, make_token().encode() + b"\n")
    sys.stdout.write(
        f'{path}: a new token\nnext: endpoint = "http" and token_file = "{path}" under [http]; enter the token on the page\n'
    )
    return 0


def write_secret(path: Path, secret: bytes) -> None:
    """Write a secret for this user alone; raise BadInput if there is a file of that name, or it cannot be written."""
    with refused(str(path), OSError), open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as out:
        out.write(secret)


async def _set_up(args: argparse.Namespace, endpoint: Endpoint, current: SigningKey | None, key: SigningKey | None) -> int:
    clock = SystemClock()
    with named_wait(f"listening on {endpoint}"):
        met = await meet(endpoint, current, args.system, clock, args.seconds)
    sys.stdout.write(_meaning(endpoint, met, current, key))
    if met.armed:
        raise BadInput("the autopilot is armed: it takes no key then; disarm it first")
    if key is not None and met.old_version:
        raise BadInput(
            f"{endpoint}: the autopilot answers in MAVLink 1, which carries no signature: with a key it would obey nobody here; "
            f"{VERSION_2_CURE} first"
        )
    if not args.yes and not _confirmed():
        sys.stdout.write("nothing was changed\n")
        return 1
    await send_key(endpoint, current, met, key, clock)
    if await observe(endpoint, key, met, clock, args.seconds):
        sys.stdout.write(
            "done: the autopilot signs with this key now\n" if key is not None else "done: the autopilot no longer signs\n"
        )
        return 0
    sys.stdout.write(
        f"it was not seen to {'sign with this key' if key is not None else 'stop signing'} within {args.seconds:g} s: either its "
        "firmware cannot sign (older PX4), or it has another key: say which with --current, or use its USB port\n"
    )
    return 1


def _meaning(endpoint: Endpoint, met: Met, current: SigningKey | None, key: SigningKey | None) -> str:
    lines = [f"{met.stack}, system {met.system}, on {endpoint}"]
    if key is None:
        lines.append("It will obey unsigned messages again: whoever reaches one of its links commands it.")
    else:
        lines += [
            f"It will get the key with the fingerprint {key.fingerprint} and keep it over restarts. From then on it obeys only",
            "messages that are signed with it (ArduPilot's USB port excepted): every ground station needs the same key.",
        ]
        if not endpoint.is_private:
            lines.append(f"The key crosses {endpoint} IN CLEAR: whoever listens has it. Better use a cable.")
    if met.signs and current is None:
        lines.append("It signs already: unless this is its USB port, it listens only to the key it has (--current).")
    return "\n".join(lines) + "\n"


def _confirmed() -> bool:
    if not sys.stdin.isatty():
        raise BadInput("no terminal to confirm this on; add --yes if you mean it")
    sys.stdout.write("Go on? [y/N] ")
    sys.stdout.flush()
    return sys.stdin.readline().strip().lower() in ("y", "yes")


# Give an autopilot a signing key or take it away, and check whether the autopilot applied the change.
#
# Source: mavlink.io, "Message signing", SETUP_SIGNING.

VERSION_2_CURE = "set SERIALn_PROTOCOL 2 (ArduPilot) or MAV_PROTO_VER 2 (PX4) for this link"
_STATION = (255, 190)


class Met(Struct, frozen=True):
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
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                first: MonoNs | None = None
                async for met in _heartbeats(links, system):
                    first = clock.now() if first is None else first
                    if not met.old_version or seconds_between(first, clock.now()) > _CHANGES_OVER_S:
                        return met
        if met is None:
            raise Recoverable(_silence(links, endpoint, current))
    return met


async def _heartbeats(links: Links, system: int | None) -> AsyncIterator[Met]:
    """Yield the autopilot of each heartbeat, of this system id if one is given."""
    async for received in links.received:
        message = received.message
        if message.get_type() == "HEARTBEAT" and system in (None, received.system) and is_autopilot(message, received.component):
            old_version = bool(message.get_msgbuf()[0] == mav.PROTOCOL_MARKER_V1)
            armed = bool(message.base_mode & ARMED)
            yield Met(received.system, received.component, stack_of(message).value, armed, _is_signed(received), old_version)


async def send_key(endpoint: Endpoint, current: SigningKey | None, to: Met, key: SigningKey | None, clock: Clock) -> None:
    """Send SETUP_SIGNING; without a key, signing is taken away."""
    secret, time = (_NO_KEY, 0) if key is None else (list(key.secret), SigningTimes(None).next())
    async with _opened(endpoint, current, clock) as links:
        for _ in range(_REPEATS):
            links.send(mav.MAVLink_setup_signing_message(to.system, to.component, secret, time))
            await clock.sleep(_PROBE_S)


async def observe(endpoint: Endpoint, key: SigningKey | None, of: Met, clock: Clock, seconds: float) -> bool:
    """Return whether the autopilot now signs with this key; without a key, whether it signs no more."""
    async with _opened(endpoint, key, clock) as links:
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                async for received in links.received:
                    its = (received.system, received.component) == (of.system, of.component)
                    if its and _is_signed(received) is (key is not None):
                        return True
    return False


@asynccontextmanager
async def _opened(endpoint: Endpoint, key: SigningKey | None, clock: Clock) -> AsyncIterator[Links]:
    signing = None if key is None else Signing(lambda: key, SigningTimes(None), 0)
    options = LinkOptions(endpoint, signing, LinkLimits(restart_first_s=0.1, restart_most_s=0.5))
    # Every sender on this link is trusted, because a person stated that the link leads to the autopilot.
    async with open_links([options], clock, _STATION, access=NamedSenders(everybody=True)) as links, asyncio.TaskGroup() as group:
        probing = group.create_task(_probe(links, clock))
        try:
            yield links
        finally:
            probing.cancel()


async def _probe(links: Links, clock: Clock) -> None:
    while True:
        links.send(TimeSyncV2(0, clock.now()))
        await clock.sleep(_PROBE_S)


def _is_signed(received: ReceivedMessage) -> bool:
    """Return whether the frame's flags mark it as signed; no key is needed to read them."""
    frame = received.message.get_msgbuf()
    return frame[0] == mav.PROTOCOL_MARKER_V2 and bool(frame[2] & mav.MAVLINK_IFLAG_SIGNED)


def _silence(links: Links, endpoint: Endpoint, current: SigningKey | None) -> str:
    link = links.all[0]
    if link.down is not None:
        return f"{endpoint} is not open: {link.down}"
    if link.counters.codec.old_version:
        return f"{endpoint}: what comes is MAVLink 1, which carries no signature; {VERSION_2_CURE}"
    if link.counters.codec.refused_signature:
        return f"{endpoint}: what comes is not signed with the key in --current"
    if link.counters.codec.messages:
        return f"{endpoint}: MAVLink, but no autopilot of a copter"
    return f"{endpoint}: no autopilot is connected" + ("" if current is None else " that signs with the key in --current")
