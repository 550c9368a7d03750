"""Measure the cost of MQTT for the daemon: `python -m benches.mqtt_cost`.

The simulated AR.Drone and the daemon run in a process each and fly for a while with MQTT off, on (TLS, a real mosquitto, default
rates, events spooled to disk), and on with no broker at the address. The output is CPU time, peak memory, and vision's delay.
Flights can be compared on a quiet machine only; therefore the MQTT part is measured alone first, with a synthetic flight of 50
decisions and 30 frames a second and an event each half second, against a loop without the part.
"""

import asyncio
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from time import process_time
from typing import Any

import msgspec

from companion.base.observer import NullObserver, Observer
from companion.guidance.make_pilot import make_pilot
from companion.service.assemble import make_daemon
from companion.settings.load import load
from companion.settings.model import CameraSettings, PadSettings, Settings
from companion.settings.mqtt import MqttSettings
from drivers.clock import SystemClock
from estimator.contracts.time import MonoNs, after, seconds_between
from sitl.scenario.scenario import load as load_scenario
from tests.support.certificates import make_certificates
from tests.support.mosquitto import MOSQUITTO, Broker
from tests.support.mqtt_service import decision, event, running
from tests.support.processed_frames import seen
from tests.support.waiting import free_port, until

SCENARIO = "demo"
FLOWN_S = 12.0
TOLD_S = 20.0
ROUNDS = 2


async def fly(settings: Settings, folder: Path) -> dict[str, Any]:
    """Fly for `FLOWN_S` and return what it took."""
    ports = [f"--{name}-port=0" for name in ("navdata", "video", "at", "control")]
    drone = await asyncio.create_subprocess_exec(
        *(
            sys.executable,
            "-m",
            "sitl.emulators.ardrone.serve",
            SCENARIO,
            "--seed=1",
            f"--truth={folder / 'truth.jsonl'}",
            *ports,
        ),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    assert drone.stdin is not None
    assert drone.stdout is not None
    try:
        open_ports = json.loads(await drone.stdout.readline())["ports"]
        vehicle = msgspec.structs.replace(settings.vehicle, **{f"{name}_port": port for name, port in open_ports.items()})
        settings = msgspec.structs.replace(settings, vehicle=vehicle)
        daemon = make_daemon(settings, make_pilot(settings))
        async with asyncio.TaskGroup() as group:
            group.create_task(daemon.run())
            await asyncio.sleep(1.0)
            began = process_time()
            await asyncio.sleep(FLOWN_S)
            spent_s = process_time() - began
            health = daemon.health.snapshot()
            daemon.stop()
    finally:
        drone.stdin.close()
        await drone.communicate()
    vision = health.stages["vision"]
    return {
        "cpu": spent_s / FLOWN_S,
        "peak_mib": getrusage(RUSAGE_SELF).ru_maxrss / 1024,
        "frames": dict(health.frames),
        "vision_p50_ms": 1e3 * (vision.p50_s or 0.0),
        "counters": dict(health.counters.get("mqtt", {})),
    }


async def measured(mqtt: MqttSettings) -> dict[str, Any]:
    """Fly in a fresh process, so that the memory is that of one flight."""
    child = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "benches.mqtt_cost", msgspec.json.encode(mqtt).decode()), stdout=asyncio.subprocess.PIPE
    )
    out, _ = await child.communicate()
    result: dict[str, Any] = json.loads(out)
    return result


async def told(part: Observer, tell: Callable[[MonoNs], None]) -> float:
    """Return the processor load, in parts of a core, of a synthetic flight with this observer."""
    clock = SystemClock()
    began, due = process_time(), clock.now()
    for k in range(round(TOLD_S * 150)):
        now = clock.now()
        if k % 3 == 0:
            part.on_decision(decision(now))
        if k % 5 == 0:
            part.on_frame(seen(now, True))
        if k % 75 == 0:
            tell(now)
        due = after(due, 1 / 150)
        await asyncio.sleep(max(0.0, seconds_between(clock.now(), due)))
    return (process_time() - began) / TOLD_S


async def part_alone(settings: MqttSettings, folder: Path) -> None:
    nobody = await told(NullObserver(), lambda _: None)
    async with running(settings, folder) as rig:
        await until(lambda: rig.count("connections") == 1)
        somebody = await told(rig.part, lambda now: rig.part.tell(event(now, "number 1")))
        counts = rig.part.counts()
    sent = {name: counts[name] for name in ("state_sent", "sighting_sent", "health_sent", "events_delivered")}
    print(f"the part alone, {TOLD_S:.0f} s: {100 * (somebody - nobody):.1f} % of a core ({sent})")


async def main() -> None:
    if MOSQUITTO is None:
        print("no mosquitto on this machine (apt install mosquitto)")
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "broker").mkdir()
        make_certificates(folder)
        broker = Broker(folder / "broker", folder)
        broker.write_files()
        broker.start()
        cases = {
            "off": MqttSettings(),
            "on": broker.settings(drone="deck", spool=str(folder / "spool"), timeout_s=5.0),
            "on, no broker": MqttSettings(transport="tcp", port=free_port(), spool=str(folder / "other")),
        }
        await part_alone(cases["on"], folder / "alone")
        found: dict[str, list[dict[str, Any]]] = {case: [] for case in cases}
        try:
            for _ in range(ROUNDS):
                for case, mqtt in cases.items():
                    found[case].append(await measured(mqtt))
        finally:
            broker.stop()
    print(f"the daemon, {ROUNDS} flights of {FLOWN_S:.0f} s each; least of the rounds")
    print(f"{'MQTT':<16} {'CPU of a core':>14} {'peak memory':>12} {'vision p50':>11}")
    for case, rounds in found.items():
        cpu, peak, vision = (min(r[key] for r in rounds) for key in ("cpu", "peak_mib", "vision_p50_ms"))
        print(f"{case:<16} {100 * cpu:12.1f} % {peak:8.0f} MiB {vision:8.1f} ms")
    print("frames:", {case: rounds[-1]["frames"] for case, rounds in found.items()})
    print("counted while on:", found["on"][-1]["counters"])


if __name__ == "__main__":
    if len(sys.argv) > 1:
        with tempfile.TemporaryDirectory() as place:
            given = msgspec.json.decode(sys.argv[1], type=MqttSettings)
            base = load("sim")
            quiet = msgspec.structs.replace(base.service, health_period_s=0.0, log_level="error")
            scenario = load_scenario(SCENARIO)
            path = msgspec.structs.replace(base.estimator, path="dead_reckoning")
            rig = msgspec.structs.replace(
                base,
                estimator=path,
                mqtt=given,
                service=quiet,
                camera=CameraSettings(scenario.camera.file),
                pad=PadSettings(scenario.pad.file),
            )
            print(json.dumps(asyncio.run(fly(rig, Path(place)))))
    else:
        asyncio.run(main())
