"""The doctor on the page: over the links that the service has open, on the ground alone."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from companion.tools.doctor import live, rules_values
from companion.tools.doctor.diagnose import PARAMETERS
from drivers.clock import SystemClock
from drivers.mavlink import samples
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.vehicle import Stack
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.companion.doctor.test_rules import ARDUPILOT
from tests.support.page_service import browsing, serving
from tests.support.waiting import until


def with_fault() -> dict[str, float]:
    good = {r.parameter: r.good for r in rules_values.RULES if r.stack == "ArduPilot"}
    return {n: ARDUPILOT.parameters.get(n, good.get(n, 0.0)) for n in PARAMETERS["ArduPilot"]} | {"PLND_TYPE": 2.0}


@asynccontextmanager
async def flown_by(fake: MiniatureAutopilot) -> AsyncIterator[Autopilot]:
    """Open the autopilot as the service does, with none of its parameters known."""
    async with fake.talking_to("udpin://127.0.0.1:0"):
        await until(lambda: fake.links is not None and fake.links.all[0].local is not None)
        assert fake.links is not None
        _, port = fake.links.all[0].local or ("", 0)
        options = AutopilotOptions(f"udpout://127.0.0.1:{port}", silence_s=1.0, command_period_s=0.01)
        async with open_autopilot(options, SystemClock()) as autopilot:
            await until(lambda: autopilot.connected)
            yield autopilot


def reads_of(fake: MiniatureAutopilot) -> int:
    """Return the parameters that were requested, beside those that the driver reads on each connect."""
    asked = [message.param_id for message in fake.messages if message.get_type() == "PARAM_REQUEST_READ"]
    return sum(name not in samples.SAMPLE_PARAMETERS[Stack.ARDUPILOT] for name in asked)


async def test_findings_come_from_the_open_links_and_only_on_the_ground(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "LISTENING_S", 0.5)
    fake = MiniatureAutopilot(parameters=with_fault())
    async with (
        flown_by(fake) as autopilot,
        serving(tmp_path, autopilot=autopilot) as service,
        browsing(service) as browser,
        browsing(service) as other,
    ):
        await browser.send(kind="examine")
        assert "the vehicle flies" in (await browser.read("examined"))["text"]
        assert reads_of(fake) == 0, "in flight nothing is asked"
        await service.lands()
        await browser.send(kind="examine")
        assert (await browser.read("examined"))["busy"]
        await other.send(kind="examine")
        assert (await other.read("examined"))["busy"]
        found, same = await asyncio.gather(browser.read("examined"), other.read("examined"))
        rules = {finding["rule"]: finding for finding in found["findings"]}
        assert rules["plnd-type"]["severity"] == "error"
        assert "PLND_TYPE" in rules["plnd-type"]["fix"]
        assert f"{len(with_fault())} parameters" in found["text"]
        assert same["findings"] == found["findings"], "one examination serves both"
        asked = reads_of(fake)
        await browser.send(kind="examine")
        assert (await browser.read("examined"))["findings"] == found["findings"]
        assert reads_of(fake) == asked, "another one within seconds asks the autopilot nothing"
        assert autopilot._listeners == []


async def test_a_take_off_ends_an_examination(tmp_path: Path) -> None:
    fake = MiniatureAutopilot(parameters=with_fault())
    async with flown_by(fake) as autopilot, serving(tmp_path, autopilot=autopilot) as service, browsing(service) as browser:
        await service.lands()
        await browser.send(kind="examine")
        assert (await browser.read("examined"))["busy"]
        service.flying = True
        assert (await browser.read("examined"))["text"] == live.TOOK_OFF
        assert autopilot.parameters is not None
        assert autopilot.parameters.settled, "nothing more is asked"
        assert autopilot._listeners == []


async def test_a_service_without_an_autopilot_is_examined_too(tmp_path: Path) -> None:
    async with serving(tmp_path) as service, browsing(service) as browser:
        (tmp_path / "token").unlink()
        await service.lands()
        await browser.send(kind="examine")
        await browser.read("examined")
        found = await browser.read("examined")
        assert [finding["rule"] for finding in found["findings"]] == ["settings-files"]
        assert found["text"].startswith("1 of ")
