"""Measure the load of a fleet on one broker: `python -m benches.mqtt_fleet`.

Twenty drones publish at the default rates, by TLS, through a real mosquitto with the shipped configuration and access list; one
ground station sees them all. Each drone also tries to write below its neighbour's name and to command it. The output is what the
ground station received of each, the broker's processor time and memory, and what follows for a thousand.
"""

import argparse
import asyncio
import contextlib
import os
import subprocess
import tempfile
import time
from pathlib import Path

from companion.parts.mqtt.connection import BrokerEndpoint, connect
from companion.parts.mqtt.watch_model import LOAD_S, WatchModel
from companion.parts.mqtt.watch_view import screen
from estimator.contracts.time import after, seconds_between
from tests.support.certificates import make_certificates
from tests.support.mosquitto import MOSQUITTO, Broker
from tests.support.mqtt_service import decision, event, running
from tests.support.processed_frames import seen

WARMED_S = 5.0
FED_HZ = 10.0
EVENT_EACH_S = 5.0
FORGED, _OWN = "forged by a neighbour", "reply/own"
_TICKS = os.sysconf("SC_CLK_TCK")


def broker_for(folder: Path, names: list[str]) -> Broker:
    """Return a running broker of the shipped configuration, with a user for each drone and one for the ground."""
    (folder / "broker").mkdir()
    make_certificates(folder)
    broker = Broker(folder / "broker", folder)
    users = [*names, "ground"]
    passwords = broker.folder / "passwords"
    passwords.write_text("".join(f"{user}:{user}-secret\n" for user in users))
    subprocess.run(["mosquitto_passwd", "-U", str(passwords)], check=True, capture_output=True)
    for user in users:
        secret = broker.folder / f"{user}.password"
        secret.write_text(f"{user}-secret\n")
        secret.chmod(0o600)
    broker.write_sample()
    for file in (passwords, broker.folder / "acl"):
        file.chmod(0o600)
    broker.start()
    return broker


async def fly(broker: Broker, folder: Path, name: str, neighbour: str) -> None:
    """Publish the synthetic flight of one drone until cancelled."""
    settings = broker.settings(name, drone=name, spool=str(folder / name), timeout_s=10.0)
    async with running(settings, folder / name, session=f"session of {name}") as rig:
        async with connect(BrokerEndpoint.of(broker.settings(name, timeout_s=10.0)), f"thief-{name}") as thief:
            for topic in (f"{neighbour}/state", f"{neighbour}/command", f"{name}/{_OWN}"):
                with contextlib.suppress(Exception):  # MQTT 5 says that it is not authorized
                    await thief.publish(f"decklander/v1/{topic}", FORGED.encode(), qos=1)
        due, k = rig.clock.now(), 0
        while True:
            now = rig.clock.now()
            rig.part.on_decision(decision(now))
            rig.part.on_frame(seen(now, True))
            if k % round(EVENT_EACH_S * FED_HZ) == 0:
                rig.part.tell(event(now, f"number {k}"))
            k, due = k + 1, after(due, 1.0 / FED_HZ)
            await asyncio.sleep(max(0.0, seconds_between(rig.clock.now(), due)))


async def listen(broker: Broker, model: WatchModel, forged: list[str]) -> None:
    """Take everything as a ground station until cancelled."""
    async with broker.ground() as ground:
        await ground.subscribe("decklander/v1/#", qos=1)
        async for publication in ground.publications():
            if FORGED.encode() in publication.payload:
                forged.append(publication.topic)
            model.on_message(publication.topic, publication.payload, time.monotonic())


def spent_s(pid: int) -> float:
    """Return the processor time of a process so far, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def resident_mb(pid: int) -> float:
    """Return the memory that a process holds, MB."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


async def measure(drones: int, seconds: float) -> None:
    """Fly the fleet and print its load."""
    names = [f"drone{k:03d}" for k in range(drones)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        broker = broker_for(folder, names)
        assert broker.process is not None
        pid, model, forged = broker.process.pid, WatchModel(connected=True), list[str]()
        before_mb = resident_mb(pid)
        try:
            async with asyncio.TaskGroup() as group:
                tasks = [group.create_task(listen(broker, model, forged))]
                await asyncio.sleep(1.0)
                for k, drone in enumerate(names):
                    tasks.append(group.create_task(fly(broker, folder, drone, names[k - 1])))
                await asyncio.sleep(WARMED_S)
                began, began_s = time.monotonic(), spent_s(pid)
                await asyncio.sleep(max(seconds, LOAD_S))
                took_s, cpu = time.monotonic() - began, spent_s(pid) - began_s
                now_s = time.monotonic()
                loads = [drone.traffic.each_second(now_s) for drone in model.drones.values()]
                shown = screen(model, now_s, 100, 6 + drones, colour=False)[: 3 + drones]
                held_mb = resident_mb(pid) - before_mb
                for task in tasks:
                    task.cancel()
        finally:
            broker.stop()
    print("\n".join(shown))
    messages, size = (sum(load[i] for load in loads) / len(loads) for i in (0, 1))
    core = cpu / took_s
    own = sum(topic.endswith(_OWN) for topic in forged)
    print(f"\n{len(loads)} drones, each {messages:.1f} messages/s, {size / 1e3:.1f} kB/s of payload")
    print(f"of {2 * drones} messages for a neighbour {len(forged) - own} got through, of {drones} for itself {own}")
    print(
        f"broker: {100 * core:.1f} % of a core, {1e3 * core / drones:.2f} ms/s for each drone; "
        f"{held_mb:.1f} MB, {1e3 * held_mb / drones:.0f} kB each"
    )
    print(
        f"on paper, 1000 drones: {1000 * messages:.0f} messages/s and {size / 1e3:.1f} MB/s, once more for each ground station; "
        f"{1000 * core / drones:.1f} of the one core that mosquitto uses, {held_mb / drones * 1000:.0f} MB"
    )


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="python -m benches.mqtt_fleet", description="Measure the load of a fleet on one broker."
    )
    parser.add_argument("--drones", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0)
    args = parser.parse_args()
    if MOSQUITTO is None:
        print("no mosquitto on this machine (apt install mosquitto)")
        return
    asyncio.run(measure(args.drones, args.seconds))


if __name__ == "__main__":
    main()
