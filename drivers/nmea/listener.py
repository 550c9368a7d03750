"""A UDP socket on which one ship's sentences arrive. Whoever speaks first is listened to until silent; others are counted."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from estimator.contracts.errors import Recoverable
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between

log = logging.getLogger(__name__)

HELD_S = 30.0
"""Silence after which another sender is listened to, unless the settings name one."""


class SentenceListener(asyncio.DatagramProtocol):
    """Passes each datagram of the ship's sender on, with the instant at which it arrived.

    Args:
        sender: the address that datagrams must come from; empty for the first that is heard.
    """

    def __init__(self, sender: str, clock: Clock, received: Callable[[bytes, MonoNs], None]) -> None:
        self._sender = sender
        self._clock = clock
        self._received = received
        self._held: tuple[tuple[str, int], MonoNs] | None = None
        self.refused: Counter[str] = Counter()
        self.lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        now, source = self._clock.now(), (addr[0], addr[1])
        if self._sender and source[0] != self._sender:
            self._refuse(source, self._sender)
            return
        held = self._held
        if held is not None and held[0] != source and seconds_between(held[1], now) <= HELD_S:
            self._refuse(source, "{}:{}".format(*held[0]))
            return
        self._held = (source, now)
        self._received(data, now)

    def _refuse(self, source: tuple[str, int], listened_to: str) -> None:
        if not self.refused["wrong_sender"]:
            log.warning(
                "sentences from %s:%d are refused, those from %s are taken; the next ones are counted only", *source, listened_to
            )
        self.refused["wrong_sender"] += 1

    def connection_lost(self, exc: Exception | None) -> None:
        if not self.lost.done():
            self.lost.set_exception(Recoverable(f"the socket for sentences is closed: {exc}"))


@asynccontextmanager
async def listening(
    address: tuple[str, int], sender: str, clock: Clock, received: Callable[[bytes, MonoNs], None]
) -> AsyncIterator[SentenceListener]:
    """Open the socket, and close it on leaving.

    Raises:
        Recoverable: the address is not of this machine, or another program has it.
    """
    loop = asyncio.get_running_loop()
    try:
        transport, protocol = await loop.create_datagram_endpoint(
            lambda: SentenceListener(sender, clock, received), local_addr=address
        )
    except OSError as why:
        raise Recoverable(f"vessel.nmea {address[0]}:{address[1]}: {why.strerror or why}") from why
    try:
        yield protocol
    finally:
        protocol.lost.cancel()
        transport.close()
