"""The start of the service and of commands: what is loaded when, vision before the first frame, and an install without PyAV."""

import asyncio
import subprocess
import sys
import threading
from pathlib import Path

import cv2
import pytest
from msgspec.structs import replace

from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.guidance.pilot import Pilot
from companion.service.daemon import Daemon, DaemonSetup
from companion.settings.guidance import GuidanceOptions
from companion.settings.service import RestartOptions
from estimator.contracts.time import MonoNs
from estimator.options import EstimatorOptions
from estimator.vision.detection import Detection, PadCheck
from tests.companion.test_daemon import CLOCK, EYES, FakeVehicle
from tests.fly import NEAR
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


class Order(NullObserver):
    """Notes decisions into a list that the preparation of vision shares."""

    def __init__(self, order: list[str]) -> None:
        self._order = order

    def on_decision(self, decision: Decision) -> None:
        self._order.append("decided")

    def on_frame(self, processed: ProcessedFrame) -> None:
        self._order.append("reported")


async def test_vision_is_prepared_once_between_the_first_cycle_and_the_first_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle, order, crate = FakeVehicle(), list[str](), PadCheck(MonoNs(1), 1.0)

    class Looks(Pilot):
        def detect(self, *args: object, **named: object) -> object:  # type: ignore[override]
            order.append(f"looked with {cv2.getNumThreads()}")
            return super().detect(*args, **named)  # type: ignore[arg-type]

    def read_deck(seen: Detection) -> Detection:
        order.append("deck read")
        return replace(seen, on_pad=crate)

    pilot = Looks(EYES, EstimatorOptions(), GuidanceOptions())
    monkeypatch.setattr(type(pilot.search), "has_unread", True)
    monkeypatch.setattr(pilot.search, "read_deck", read_deck)
    monkeypatch.setattr(pilot.landing, "on_pad", lambda check: order.append("told") if check is crate else None)
    restart, prepare = RestartOptions(0.01, 1.0, 0.01, 5.0), lambda: order.append(threading.current_thread().name)
    daemon = Daemon(vehicle.open, pilot, CLOCK, DaemonSetup(restart, 50.0, threads=1, prepare=prepare), observers=[Order(order)])
    cv2.setNumThreads(2)
    async with asyncio.TaskGroup() as group:
        group.create_task(daemon.run())
        await until(lambda: "vision" in order)
        for seq in (1, 2):
            for _ in range(2):  # the exposure lies between two attitudes
                vehicle.say(flying=True)
                await asyncio.sleep(0.04)
            vehicle.film(seq, late_s=0.05)
            await until(lambda n=seq: daemon.health.frames.total() >= n and "told" in order)  # type: ignore[misc]
        daemon.stop()
    assert order[0] == "decided"
    assert order.count("vision") == 1
    assert "looked with 2" not in order
    assert [entry for entry in order if entry != "decided"][:5] == ["vision", "looked with 1", "reported", "deck read", "told"]


ROOT = Path(__file__).parents[2]
_WITHOUT = """
import sys
from importlib.abc import MetaPathFinder
class Hidden(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "av":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hidden())
import importlib.util, drivers.pyav
drivers.pyav.find_spec = lambda name: None
from companion.cli import main
for words in sys.argv[1:]:
    print(main.main(words.split()))
"""


def test_without_pyav_a_pixhawk_and_a_webcam_work_and_other_video_is_refused_by_its_setting(tmp_path: Path) -> None:
    photo, film = ROOT / "configs/examples/pad.jpg", tmp_path / "film.mp4"
    film.write_bytes(b"no image")
    (tmp_path / "near.toml").write_text(NEAR)
    commands = (
        "run --config raspberry_ardupilot --check",
        f"detect {photo} --camera sim --pad thesis",
        "simulate near.toml --seed 3 --perception model",
        "config check ardrone1",
        "run --config ardrone2 --check",
        f"detect {film} --camera sim --pad thesis",
    )
    program, environment = [sys.executable, "-c", _WITHOUT, *commands], {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(program, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    printed = done.stderr
    assert [line for line in done.stdout.splitlines() if line.isdigit()] == ["0", "0", "0", "0", "2", "2"], printed
    assert 'vehicle.model = "2.0" needs PyAV' in printed
    assert f"{film}: a video needs PyAV" in printed
    assert printed.count("decklander[video]") == 2
    assert "Traceback" not in printed
