"""Open the way to a ship's network: a CAN interface, a gateway by TCP or serial port, or a Signal K server."""

import asyncio
import logging
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn

import aiohttp

from drivers.endpoint import BusAddress, Endpoint
from drivers.nmea.ship_bus import CLAIM, KINDS, BusReader, greeting, question
from drivers.nmea.ship_sensors import Samples
from drivers.wires import open_wire
from estimator.contracts.errors import Recoverable, refused
from estimator.contracts.time import Clock, MonoNs

if TYPE_CHECKING:
    import can

_BITRATE = 250_000
"""The rate of every NMEA 2000 network, bit/s; an interface of Linux has it from its own setup."""
_RECV_S = 0.2  # longest wait for a frame of the CAN bus
_AT_ONCE = 256  # frames of the CAN bus that are read at once
_SIGNALK_S = 5.0  # time to connect to a Signal K server, and interval of its heartbeat
_DELTA_MAX = 1 << 18  # longest message of a Signal K server, bytes

Offer = Callable[[Samples], None]


async def read_bus(address: BusAddress, reader: BusReader, offer: Offer, clock: Clock, opened: Callable[[], None]) -> NoReturn:
    """Read until cancelled.

    Args:
        offer: takes the samples as they arrive.
        opened: called once the network is reached.

    Raises:
        Recoverable: it cannot be reached, or no longer.
    """
    reader.restart()
    with refused(f"vessel.bus {address.text}", Recoverable, by=Recoverable):
        if address.signalk is not None:
            await _read_signalk(address.signalk, reader, offer, clock, opened)
        if address.can is not None:
            await _read_can(address.can, reader, offer, clock, opened)
        assert address.wire is not None
        async with open_wire(address.wire, clock, lambda data, at, _: offer(reader.feed(data, at))) as wire:
            opened()
            if address.wire.scheme == "serial":
                wire.send(greeting, None)
            await wire.broken()


async def _read_can(
    channel: tuple[str, str], reader: BusReader, offer: Offer, clock: Clock, opened: Callable[[], None]
) -> NoReturn:
    import can

    logging.getLogger("can").setLevel(logging.CRITICAL)  # an interface that is not there is logged once, by the service
    # Only broadcast messages are used: the kernel drops the others.
    filters = [{"can_id": pgn << 8, "can_mask": 0x3FFFF00, "extended": True} for pgn in (*KINDS, CLAIM | 0xFF)]
    more: dict[str, Any] = {} if channel[0] == "socketcan" else {"bitrate": _BITRATE}
    try:
        with await asyncio.to_thread(partial(can.Bus, channel[1], channel[0], can_filters=filters, **more)) as bus:
            opened()
            with suppress(can.CanError, OSError):  # an interface that only listens
                can_id, data = question()
                await asyncio.to_thread(bus.send, can.Message(arbitration_id=can_id, data=data, is_extended_id=True), 0.1)
            while True:
                for message, at in await asyncio.to_thread(_received, bus, clock):
                    if message.is_extended_id and not message.is_error_frame and not message.is_remote_frame:
                        offer(reader.arrived(message.arbitration_id, bytes(message.data), at))
    except (can.CanError, OSError, ValueError, ImportError) as why:
        raise Recoverable(str(why) or type(why).__name__) from why


def _received(bus: "can.BusABC", clock: Clock) -> "list[tuple[can.Message, MonoNs]]":
    """Return the frames that wait, or the next one."""
    out, wait_s = list["tuple[can.Message, MonoNs]"](), _RECV_S
    while len(out) < _AT_ONCE and (message := bus.recv(wait_s)) is not None:
        out.append((message, clock.now()))
        wait_s = 0.0
    return out


async def _read_signalk(where: Endpoint, reader: BusReader, offer: Offer, clock: Clock, opened: Callable[[], None]) -> NoReturn:
    url = f"{where}/signalk/v1/stream?subscribe=self&sendCachedValues=false".replace("tcp://", "http://")
    timeout = aiohttp.ClientTimeout(total=None, connect=_SIGNALK_S)
    try:
        async with (
            aiohttp.ClientSession(timeout=timeout) as session,
            session.ws_connect(url, heartbeat=_SIGNALK_S, max_msg_size=_DELTA_MAX) as socket,
        ):
            opened()
            async for message in socket:
                if message.type is aiohttp.WSMsgType.TEXT:
                    offer(reader.line(message.data.encode(), clock.now()))
    except aiohttp.WSServerHandshakeError as why:
        raise Recoverable(f"the server answers {why.status} {why.message}") from why
    except (aiohttp.ClientError, OSError, TimeoutError) as why:
        raise Recoverable(str(why) or type(why).__name__) from why
    raise Recoverable("the server closed the connection")
