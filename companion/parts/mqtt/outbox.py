"""Keep events until the broker has them: in a queue in memory, in the spool, in batches of QoS 1.

Only a separate thread uses the disk, so a slow card delays nothing but the events.
"""

import asyncio
import logging
from collections.abc import Mapping
from typing import Literal

from companion.base.worker import Worker
from companion.parts.mqtt.connection import Connection
from companion.parts.mqtt.encode import PendingEvent
from companion.parts.mqtt.messages import EventMessage, encode
from companion.parts.mqtt.spool import Spool
from drivers.mailbox import Line
from estimator.contracts.errors import Recoverable

log = logging.getLogger(__name__)

Fsync = Literal["always", "second", "never"]

LINE = 1024
"""The number of events that may wait for the disk."""
BATCH = 16
"""The number of events in flight at once: fewer than brokers accept unacknowledged (mosquitto: 20)."""
_SYNC_S = 1.0  # time without an event after which those before are synchronized to the disk
_CLOSE_S = 1.2  # time that the events in memory have to reach the disk at the end
_REFUSED_REST_S = 5.0  # time before events that the broker refused are sent again


class Outbox:
    """Takes events from the loop's thread, numbers and stores them, and delivers them in order."""

    def __init__(self, spool: Spool, session: str, topic: str, fsync: Fsync) -> None:
        self._spool = spool
        self._session = session
        self._topic = topic
        self._fsync = fsync
        self._line: Line[PendingEvent] = Line(LINE)
        self._more = asyncio.Event()
        self._disk = Worker("spool", waiting=64)
        self._unsynced = False
        self.delivered = 0
        self.refused = 0

    def put(self, event: PendingEvent) -> None:
        """Queue an event. This never blocks and never fails; beyond `LINE` waiting events the oldest is dropped and counted."""
        self._line.offer(event)

    def counts(self) -> Mapping[str, float]:
        """Return the counters of events for health."""
        spool = self._spool
        return {
            "events_delivered": self.delivered,
            "events_waiting": spool.waiting + len(self._line),
            "events_dropped": spool.dropped + self._line.dropped,
            "events_refused": self.refused,
            "spool_bytes": spool.size_bytes,
            "spool_torn": spool.torn,
            "spool_write_errors": spool.write_errors,
        }

    async def keep(self) -> None:
        """Move events from memory to disk until cancelled."""
        while True:
            try:
                async with asyncio.timeout(_SYNC_S if self._unsynced else None):
                    event = await self._line.get()
            except TimeoutError:
                self._unsynced = False
                await self._disk.run(self._spool.sync)
                continue
            await self._append([event, *await self._waiting()])

    async def flush(self) -> None:
        """Move the events that wait in memory to disk now."""
        if len(self._line):
            await self._append(await self._waiting())

    async def deliver(self, connection: Connection) -> None:
        """Publish events as they come, in order, until cancelled.

        Raises:
            aiomqtt.MqttError: the broker failed; events that it has not acknowledged are sent again on the next connection.
        """
        while True:
            self._more.clear()
            refused = self.refused
            if await self.deliver_batch(connection):
                continue
            if self.refused > refused:
                await asyncio.sleep(_REFUSED_REST_S)
            else:
                await self._more.wait()

    async def deliver_batch(self, connection: Connection) -> int:
        """Publish the oldest events; return how many the broker took, 0 if there are none or it refuses them.

        Raises:
            aiomqtt.MqttError: the broker failed.
        """
        records = await self._disk.run(self._spool.peek, BATCH)
        if not records:
            return 0
        refusals = connection.refusals
        async with asyncio.TaskGroup() as group:
            for record in records:
                group.create_task(connection.publish_message(self._topic, record.body, qos=1))
        if connection.refusals > refusals:
            self.refused += connection.refusals - refusals
            return 0
        await self._disk.run(self._spool.deliver, records[-1].number)
        self.delivered += len(records)
        return len(records)

    async def close(self) -> None:
        """Move everything to disk, sync it and end the thread; abandon a disk that takes longer than about a second."""
        try:
            async with asyncio.timeout(_CLOSE_S):
                await self.flush()
                await self._disk.run(self._spool.close)
        except (TimeoutError, Recoverable):
            log.error("mqtt.spool: the disk took nothing for %.1f s; %d events may be lost", _CLOSE_S, self._spool.waiting)
        self._disk.close()

    async def _waiting(self) -> list[PendingEvent]:
        """Return all queued events without a pause, so that no cancellation can come between taking and spooling them."""
        return [await self._line.get() for _ in range(len(self._line))]

    async def _append(self, events: list[PendingEvent]) -> None:
        await self._disk.run(self._append_now, events, self._fsync == "always")
        self._unsynced = self._fsync == "second"
        self._more.set()

    def _append_now(self, events: list[PendingEvent], sync: bool) -> None:
        first = self._spool.next_number
        self._spool.append([self._encoded(h, number) for number, h in enumerate(events, first)])
        if sync:
            self._spool.sync()

    def _encoded(self, event: PendingEvent, number: int) -> bytes:
        return encode(
            EventMessage(
                session=self._session,
                at_ns=event.at,
                id=f"{self._session}-{number}",
                spool=self._spool.name,
                sequence=number,
                kind=event.kind,
                text=event.text,
                data=dict(event.data),
            )
        )
