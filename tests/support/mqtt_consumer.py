"""A consumer of events as one would write it: a session that the broker keeps, and ids to tell copies by."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import aiomqtt
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from companion.parts.mqtt.connection import BrokerEndpoint
from companion.parts.mqtt.messages import EventMessage, decode
from tests.support.mosquitto import Broker


class Consumer:
    """Collects the events called "number N" until it has `total` of them."""

    def __init__(self, broker: Broker, total: int) -> None:
        self._broker = broker
        self._total = total
        self._ids: set[str] = set()
        self.numbers: list[int] = []
        self.others: list[EventMessage] = []
        self.copies = 0
        self.listening = asyncio.Event()
        self.done = asyncio.Event()

    async def run(self) -> None:
        """Run for ever, connecting again when the broker goes away."""
        while True:
            try:
                await self._listen()
            except aiomqtt.MqttError:
                await asyncio.sleep(0.05)

    async def _listen(self) -> None:
        settings = self._broker.settings("ground")
        endpoint = BrokerEndpoint.of(settings)
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.SessionExpiryInterval = 3600
        async with aiomqtt.Client(
            settings.host, settings.port, username="ground", password=endpoint.password, tls_context=endpoint.tls,
            identifier="consumer", protocol=aiomqtt.ProtocolVersion.V5, clean_start=False, properties=properties, timeout=2.0,
        ) as client:  # fmt: skip
            await client.subscribe("decklander/v2/deck/event", qos=1)
            self.listening.set()
            async for message in client.messages:
                assert isinstance(message.payload, bytes)
                self._take(message.payload)

    def _take(self, payload: bytes) -> None:
        event = decode("event", payload)
        if event.id in self._ids:
            self.copies += 1
            return
        self._ids.add(event.id)
        if event.text.startswith("number "):
            self.numbers.append(int(event.text.removeprefix("number ")))
        else:
            self.others.append(event)
        if len(self.numbers) == self._total:
            self.done.set()


@asynccontextmanager
async def consuming(broker: Broker, total: int) -> AsyncIterator[Consumer]:
    """Yield a consumer that listens."""
    consumer = Consumer(broker, total)
    task = asyncio.create_task(consumer.run())
    await consumer.listening.wait()
    yield consumer
    task.cancel()
