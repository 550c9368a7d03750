"""Events through an outage: none lost, order kept, copies recognisable."""

import asyncio
import signal
from pathlib import Path

import pytest

from tests.support.mosquitto import Broker
from tests.support.mqtt_consumer import Consumer
from tests.support.mqtt_service import event, running
from tests.support.waiting import until

# A TLS handshake that is ended leaves its socket to the garbage collector inside paho.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed <ssl.SSLSocket:ResourceWarning")


async def test_events_survive_a_broker_that_stops_and_one_that_is_killed(broker: Broker, tmp_path: Path) -> None:
    total = 500
    consumer = Consumer(broker, total)
    async with asyncio.TaskGroup() as group:
        consuming = group.create_task(consumer.run())
        await consumer.listening.wait()
        async with running(broker.settings(), tmp_path / "spool") as rig:
            await until(lambda: rig.count("connections") == 1)
            for n in range(total):
                if n == 100:
                    stopped = group.create_task(asyncio.to_thread(broker.away, signal.SIGTERM, 1.0))
                if n == 400:
                    await stopped
                    await until(lambda: rig.count("connections") == 2)
                    # What the broker has acknowledged and not handed on when it is killed is lost by the broker, not by us.
                    await until(lambda: len(consumer.numbers) == 400)
                    group.create_task(asyncio.to_thread(broker.away, signal.SIGKILL, 0.2))
                rig.part.tell(event(rig.clock.now(), f"number {n}"))
                await asyncio.sleep(0.003)
            async with asyncio.timeout(60):
                await consumer.done.wait()
            assert rig.count("connections") >= 3
            await until(lambda: rig.count("events_waiting") == 0)
            assert rig.count("events_dropped") == 0
        consuming.cancel()
    assert consumer.numbers == list(range(total))


async def test_events_of_a_service_without_a_broker_come_with_the_next_one(broker: Broker, tmp_path: Path) -> None:
    """Session one meets no broker at all and ends; session two delivers what it left, first."""
    broker.stop()
    async with running(broker.settings(), tmp_path / "spool", session="one") as rig:
        for n in range(40):
            rig.part.tell(event(rig.clock.now(), f"number {n}"))
        await until(lambda: rig.count("connection_failures") >= 2)
    broker.start()
    consumer = Consumer(broker, 41)
    async with asyncio.TaskGroup() as group:
        consuming = group.create_task(consumer.run())
        await consumer.listening.wait()
        async with running(broker.settings(), tmp_path / "spool", session="two") as rig:
            rig.part.tell(event(rig.clock.now(), "number 40"))
            async with asyncio.timeout(60):
                await consumer.done.wait()
        consuming.cancel()
    assert consumer.numbers == list(range(41))
    assert [e.text for e in consumer.others[:3]] == ["service started", "service stopped", "service started"]
    assert {e.session for e in consumer.others[:2]} == {"one"}


async def test_stopping_at_any_moment_loses_no_event(broker: Broker, tmp_path: Path) -> None:
    """The service is cancelled while it connects, subscribes, spools, publishes; what it said is delivered or on disk."""
    reported = 0
    consumer = Consumer(broker, 10**9)
    async with asyncio.TaskGroup() as group:
        consuming = group.create_task(consumer.run())
        await consumer.listening.wait()
        for k in range(14):
            async with running(broker.settings(), tmp_path / "spool", session=f"s{k}") as rig:
                for _ in range(5):
                    rig.part.tell(event(rig.clock.now(), f"number {reported}"))
                    reported += 1
                await asyncio.sleep(0.0025 * k)
        async with running(broker.settings(), tmp_path / "spool", session="last"):
            await until(lambda: len(consumer.numbers) == reported)
        consuming.cancel()
    assert consumer.numbers == list(range(reported))
