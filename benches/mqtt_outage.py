"""Send events through a broker that is stopped for 30 s and killed once: `python -m benches.mqtt_outage`.

The test connects a real mosquitto with TLS, the service's own part, and a consumer with a persistent session. The output is what
arrived and how long the events waited. The exit code is 1 if one is missing or out of order.
"""

import asyncio
import signal
import sys
import tempfile
import time
from pathlib import Path

from tests.support.certificates import make_certificates
from tests.support.mosquitto import MOSQUITTO, Broker
from tests.support.mqtt_consumer import Consumer
from tests.support.mqtt_service import event, running
from tests.support.waiting import until

EVENTS = 10_000
EACH_S = 0.005
STOP_AT, STOPPED_S = 1_500, 30.0
KILL_AT = 9_000


async def main() -> int:
    if MOSQUITTO is None:
        print("no mosquitto on this machine (apt install mosquitto)")
        return 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "broker").mkdir()
        make_certificates(folder)
        broker = Broker(folder / "broker", folder)
        broker.write_files()
        broker.start()
        try:
            return await outage(broker, folder / "spool")
        finally:
            broker.stop()


async def outage(broker: Broker, spool: Path) -> int:
    consumer = Consumer(broker, EVENTS)
    most_waiting, late_s = 0.0, 0.0
    async with asyncio.TaskGroup() as group:
        consuming = group.create_task(consumer.run())
        await consumer.listening.wait()
        async with running(broker.settings(reconnect_cap_s=1.0), spool) as rig:
            await until(lambda: rig.count("connections") == 1)
            began = time.monotonic()
            for n in range(EVENTS):
                if n == STOP_AT:
                    stopped = group.create_task(asyncio.to_thread(broker.away, signal.SIGTERM, STOPPED_S))
                if n == KILL_AT:
                    await stopped
                    group.create_task(asyncio.to_thread(broker.away, signal.SIGKILL, 0.0))
                rig.part.tell(event(rig.clock.now(), f"number {n}"))
                due = time.monotonic() + EACH_S
                await asyncio.sleep(EACH_S)
                late_s = max(late_s, time.monotonic() - due)
                most_waiting = max(most_waiting, rig.count("events_waiting"))
            took_s = time.monotonic() - began
            async with asyncio.timeout(60):
                await consumer.done.wait()
            after_s = time.monotonic() - began - took_s
            counts = dict(rig.part.counts())
        consuming.cancel()
    lost = EVENTS - len(set(consumer.numbers))
    ordered = consumer.numbers == sorted(consumer.numbers)
    print(f"{EVENTS} events in {took_s:.0f} s; the broker stopped for {STOPPED_S:.0f} s, later killed")
    print(f"  lost {lost}, in order: {ordered}, copies thrown away by their id: {consumer.copies}")
    print(f"  most waiting on disk {most_waiting:.0f}, all there {after_s:.1f} s after the last was told")
    print(f"  connections {counts['connections']:.0f}, failures {counts['connection_failures']:.0f}, "
          f"dropped {counts['events_dropped']:.0f}, the loop at most {1e3 * late_s:.0f} ms late")  # fmt: skip
    return 0 if lost == 0 and ordered else 1


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
