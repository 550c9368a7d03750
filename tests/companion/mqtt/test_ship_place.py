"""The ship's place through a real broker, by the script of the page: the service flies to it."""

import asyncio
import json
import math
import sys
from pathlib import Path

import msgspec

from companion.base.mission import State
from companion.parts.mqtt.connection import BrokerEndpoint, connect
from companion.settings.load import load
from tests.companion.test_ship_reports import SHIP_NED, flying, place_of, settings_of
from tests.support.waiting import free_port, until

ROOT = Path(__file__).parents[3]
KEY = bytes(range(32))


async def test_the_script_of_the_page_leads_the_drone_to_the_ship_and_nobody_without_its_key(broker, tmp_path):
    key_file = tmp_path / "command.key"
    key_file.touch(0o600)
    key_file.write_bytes(KEY)
    port = free_port()
    mqtt = broker.settings(commands="signed", command_key_file=str(key_file), health_hz=10.0)
    settings = msgspec.structs.replace(settings_of(port, mqtt=True), mqtt=mqtt)
    settings = msgspec.structs.replace(settings, recorder=msgspec.structs.replace(load("sim").recorder, enabled=False))
    at = place_of(SHIP_NED)
    line = f"{math.degrees(at.latitude_rad):.7f} {math.degrees(at.longitude_rad):.7f} 2.0 90.0 90.0\n".encode()
    words = ["localhost", str(broker.port), str(broker.certificates / "ca.crt"), "ship", str(broker.folder / "ship.password")]
    gateway = connect(BrokerEndpoint.of(broker.settings("ship", timeout_s=10.0)), "gateway")
    async with flying(settings, port) as service, gateway as without_key, asyncio.timeout(300):
        assert "no place from the ship yet" in service.missing()
        await until(lambda: service.counted("mqtt").get("connections", 0) == 1)
        forged = {"run": "0" * 32, "at_ns": 1, "latitude_deg": 54.4, "longitude_deg": 10.2}
        await without_key.publish_message("decklander/v2/deck/vessel", json.dumps(forged).encode(), qos=1)
        child = await asyncio.create_subprocess_exec(
            *(sys.executable, str(ROOT / "examples/ship_reports.py"), *words, "deck", str(key_file)),
            stdin=asyncio.subprocess.PIPE,
        )
        try:
            while not service.towards_ship():
                child.stdin.write(line)
                await asyncio.sleep(0.3)
        finally:
            child.stdin.close()
            await child.wait()
        assert service.pilot.state is State.RENDEZVOUS
        assert service.counted("mqtt")["ship_reports_unsigned"] == 1
        assert service.counted("ship_place")["taken"] >= 1
        assert not [words for words in service.missing() if "ship" in words]
