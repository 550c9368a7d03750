"""One service has a vehicle: a second one ends in one line before it opens anything, and nothing of a dead one bars the next."""

import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path

import pytest
from msgspec import structs

from companion.parts.mqtt.options import MqttSettings
from companion.service.sole_service import sole_service
from companion.settings.load import load
from companion.settings.model import Settings
from decklander.place import SHIPPED
from drivers.ardrone.options import ArDroneOptions
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.errors import BadInput
from tests.support.processes import decklander, started
from tests.support.waiting import free_port, wait_until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the lock is a socket of the abstract kind, which Linux has")
PORT, OTHER = free_port(), free_port()
OFF = MqttSettings()


def settings_of(vehicle: ArDroneOptions | AutopilotOptions, mqtt: MqttSettings = OFF) -> Settings:
    return structs.replace(load("sim"), vehicle=vehicle, mqtt=mqtt)


def ardrone(port: int = PORT, host: str = "127.0.0.1", drone: str = "") -> Settings:
    mqtt = MqttSettings(transport="tcp", host="127.0.0.1", port=PORT, drone=drone) if drone else OFF
    return settings_of(ArDroneOptions(host=host, at_port=port), mqtt)


def autopilot(links: str, system: int = 0) -> Settings:
    return settings_of(AutopilotOptions(links=links.format(PORT), system_id=system))


ROUTER = "udpout://127.0.0.1:{}"
PAIRS: list[tuple[Settings, Settings, str]] = [
    (ardrone(), ardrone(), "the AR.Drone at 127.0.0.1"),
    (ardrone(), ardrone(host="localhost"), "the AR.Drone at localhost"),
    (ardrone(), ardrone(OTHER), ""),
    (ardrone(drone="a"), ardrone(OTHER, drone="a"), "the name 'a' at the broker"),
    (ardrone(drone="a"), ardrone(OTHER, drone="b"), ""),
    (autopilot("serial:///dev/null:57600"), autopilot("serial:///dev/../dev/null:921600", 3), "the autopilot on serial:///dev/"),
    (autopilot("udpin://127.0.0.1:{}", 1), autopilot("udpin://127.0.0.1:{}", 2), "the autopilot on udpin"),
    (autopilot("udpin://127.0.0.1:0"), autopilot("udpin://127.0.0.1:0"), ""),
    (autopilot(ROUTER, 1), autopilot(ROUTER, 1), "the autopilot on udpout"),
    (autopilot(ROUTER, 1), autopilot(ROUTER, 2), ""),
    (autopilot(ROUTER, 1), autopilot(ROUTER), "the autopilot on udpout"),
    (autopilot(ROUTER), autopilot(ROUTER, 9), "the autopilot on udpout"),
    (autopilot(f"serial:///dev/null:57600,{ROUTER}", 1), autopilot(ROUTER, 1), "the autopilot on udpout"),
    (ardrone(), autopilot(ROUTER), ""),
]


@pytest.mark.parametrize(("first", "second", "shared"), PAIRS)
def test_what_two_rigs_share_bars_the_second_and_what_they_do_not_share_does_not(first, second, shared, tmp_path):
    file = tmp_path / ("a" * 60) / "first.toml"
    with ExitStack() as held:
        held.enter_context(sole_service(first, file))
        with pytest.raises(BadInput, match="end that one first") if shared else nullcontext() as refused:
            held.enter_context(sole_service(second, tmp_path / "second.toml"))
    if shared:
        assert shared in str(refused.value)
        assert "another service, process " in str(refused.value)
        assert "/first.toml," in str(refused.value)
    with sole_service(second, file):
        pass


@contextmanager
def started_service(file: Path, log: Path) -> Iterator[subprocess.Popen[str]]:
    with log.open("w") as out, started(decklander("run", "--config", str(file)), stdout=out, stderr=out) as service:
        yield service


@pytest.mark.hazard("H8", "A12")
def test_a_second_service_opens_nothing_and_a_killed_one_bars_nobody(tmp_path: Path) -> None:
    file, logs = tmp_path / "rig.toml", [tmp_path / name for name in ("first", "second", "third", "next")]
    with ExitStack() as stack:
        kinds = {
            "navdata": socket.SOCK_DGRAM,
            "video": socket.SOCK_STREAM,
            "at": socket.SOCK_DGRAM,
            "control": socket.SOCK_STREAM,
        }
        ports = {name: stack.enter_context(socket.socket(socket.AF_INET, kind)) for name, kind in kinds.items()}
        for port in ports.values():
            port.bind(("127.0.0.1", 0))
            port.setblocking(False)
        for name in ("video", "control"):
            ports[name].listen()
        lines = [f"{name}_port = {port.getsockname()[1]}\n" for name, port in ports.items()]
        file.write_text((SHIPPED / "sim.toml").read_text() + "[expert.vehicle]\n" + "".join(lines))
        with sole_service(load(str(file)), file), started_service(file, logs[0]) as second:
            assert second.wait() == 2
        assert not select.select(list(ports.values()), [], [], 0.0)[0], "it sent or connected"

        with started_service(file, logs[1]) as first:
            wait_until(lambda: "waiting for" in logs[1].read_text())
            first.send_signal(signal.SIGSTOP)  # one that stands still has it too
            with started_service(file, logs[2]) as second:
                assert second.wait() == 2
            (line,) = logs[2].read_text().splitlines()
            assert line.startswith(f"decklander: another service, process {first.pid} with ")
            assert line.endswith(
                "/rig.toml, has the AR.Drone at 127.0.0.1: end that one first, or give this one another vehicle.host; "
                "this one opened nothing, and ends"
            )
            first.kill()
            first.wait()
            with started_service(file, logs[3]):
                wait_until(lambda: "waiting for" in logs[3].read_text())
