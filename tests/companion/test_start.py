"""The service's start: what the first guidance cycle does not need is loaded after it, and vision before the first frame."""

import asyncio
import subprocess
import sys
import threading
from pathlib import Path

import cv2

from companion.base.observer import Decision
from companion.guidance.pilot import Pilot
from companion.service.daemon import Daemon, DaemonSetup
from companion.settings.guidance import GuidanceOptions
from companion.settings.service import RestartOptions
from estimator.options import EstimatorOptions
from tests.companion.test_daemon import CLOCK, EYES, FakeVehicle
from tests.fly import ObservedCalls
from tests.support.waiting import until

LATER = ("av", "cv2", "email", "importlib.metadata", "msgspec.inspect", "numpy.ma", "estimator.vision.tracker")
"""Modules that take long to load and that no guidance cycle needs."""
PROBE = """
import sys
from companion.cli import main, run
from companion.base import signals
from companion.service.daemon import Daemon, DaemonSetup

def first(self, decision):
    print(*sorted(set(sys.argv[2].split(",")) & set(sys.modules)))
    self.stop()

Daemon._tell = first
arguments = main.argparse.Namespace(config=sys.argv[1], check=False, once=False)
sys.exit(signals.leave(run.run(main.Parser().parse_args([], arguments))))
"""


def test_the_first_guidance_cycle_waits_for_nothing_that_it_does_not_need(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    ports = "[expert.vehicle]\nnavdata_port = 45654\nvideo_port = 45655\nat_port = 45656\ncontrol_port = 45659"
    rig.write_text(
        f'[vehicle]\nkind = "ardrone"\nhost = "127.0.0.1"\n{ports}\n[camera]\nfile = "sim"\n[pad]\nfile = "thesis"\n'
        '[operator]\nsocket = "off"\n'
    )
    done = subprocess.run(
        [sys.executable, "-c", PROBE, str(rig), "", ",".join(LATER)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "\n"


class Order(ObservedCalls):
    """Notes decisions into a list that the preparation of vision shares."""

    def __init__(self, order: list[str]) -> None:
        super().__init__()
        self._order = order

    def on_decision(self, decision: Decision) -> None:
        super().on_decision(decision)
        self._order.append("decided")


async def test_vision_is_prepared_once_on_its_own_thread_between_the_first_cycle_and_the_first_frame() -> None:
    vehicle, order = FakeVehicle(), list[str]()

    class Looks(Pilot):
        def detect(self, *args: object, **named: object) -> object:  # type: ignore[override]
            order.append(f"looked with {cv2.getNumThreads()}")
            return super().detect(*args, **named)  # type: ignore[arg-type]

    daemon = Daemon(
        vehicle.open,
        Looks(EYES, EstimatorOptions(), GuidanceOptions()),
        CLOCK,
        DaemonSetup(
            RestartOptions(0.01, 1.0, 0.01, 5.0), 50.0, threads=1, prepare=lambda: order.append(threading.current_thread().name)
        ),
        observers=[Order(order)],
    )
    cv2.setNumThreads(2)
    async with asyncio.TaskGroup() as group:
        group.create_task(daemon.run())
        await until(lambda: "vision" in order)
        for seq in (1, 2):
            for _ in range(2):  # the exposure lies between two attitudes
                vehicle.say(flying=True)
                await asyncio.sleep(0.04)
            vehicle.film(seq, late_s=0.05)
            await until(lambda n=seq: sum(entry.startswith("looked") for entry in order) == n)  # type: ignore[misc]
        daemon.stop()
    assert order[0] == "decided"
    assert order.count("vision") == 1
    assert order.index("vision") < order.index("looked with 1")
    assert "looked with 2" not in order
