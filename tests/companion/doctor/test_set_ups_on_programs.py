"""The most dangerous set-ups on the real programs, which fly by their own simulated vehicle: the doctor names, mends and undoes.

They run where `DECKLANDER_ARDUCOPTER` or `DECKLANDER_PX4` names a program (docs/sitl.md).
"""

import asyncio
import json
import os
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from companion.cli.main import main
from sitl.emulators.autopilots.programs import arducopter, px4
from sitl.emulators.autopilots.programs.program import Program, running
from tests.companion.doctor.test_set_ups import DATA
from tests.support.waiting import free_port

PROGRAMS = {stack: os.environ.get(f"DECKLANDER_{name}", "") for stack, name in (("ArduPilot", "ARDUCOPTER"), ("PX4", "PX4"))}
DANGEROUS = {
    "ArduPilot": (
        "lands blind", "descends wherever it is", "blind below two metres", "EKF waits for vision", "height from the deck",
        "a dead service flies on", "GUIDED holds nothing", "strikes the deck", "comes down like a stone",
        "cannot follow a falling deck", "cannot flee a rising deck", "lands in the sea without a remote",
        "falls with an empty battery", "returns to where the ship was", "EKF check off",
    ),
    "PX4": (
        "flies on when the service dies", "lands in the sea when the service dies", "falls when the service dies",
        "setpoints not passed on", "height from the deck", "no velocity from GNSS", "waits for vision",
        "a landing that is no descent", "the ship's way hides the landing", "turns over at take-off",
        "cannot follow a falling deck", "cannot flee a rising deck", "falls without a remote",
        "lands in the sea without a station", "returns to where the ship was",
    ),
}  # fmt: skip
CASES = [(stack, name) for stack, names in DANGEROUS.items() for name in names]


OWN = {"ArduPilot": (), "PX4": ("px4-battery-action",)}
"""Wrong settings of a program's own start-up for simulations: PX4's sets COM_LOW_BAT_ACT to 3 in every case."""


@asynccontextmanager
async def autopilot_program(stack: str, parameters: Mapping[str, float], folder: Path) -> AsyncIterator[tuple[Program, str]]:
    """Run the program with parameters over the doctor's good ones; yield it and the URL of its link."""
    asked = {name: float(value) for name, value in (DATA[stack]["good"]["defaults"] | dict(parameters)).items()}
    binary = Path(PROGRAMS[stack])
    if stack == "ArduPilot":
        ports = (free_port(), free_port())
        words = arducopter.argv(binary, folder, physics=1, mavlink_ports=ports, parameters=asked)
        words[words.index("--model") + 1] = "quad"
        environment: dict[str, str] = {}
        port = ports[0]
    else:
        words, environment = px4.start(binary, height_m=4.0, parameters=asked)
        environment |= {"PX4_SIM_MODEL": "sihsim_quadx", "PX4_SYS_AUTOSTART": "10040"}
        port = px4.MAVLINK_PORTS[0]
    async with running(words, folder, environment) as started:
        yield started, f"udpin://127.0.0.1:{port}"


def examined(capsys: pytest.CaptureFixture[str], *words: str) -> set[str]:
    """Return the rules that the doctor's findings are named by."""
    capsys.readouterr()
    main(["doctor", *words, "--json", "--seconds", "8"])
    output = capsys.readouterr()
    assert "Traceback" not in output.err
    return {json.loads(line)["rule"] for line in output.out.splitlines() if line.startswith("{")}


@pytest.mark.timeout(300)
@pytest.mark.parametrize(("stack", "name"), CASES)
async def test_a_dangerous_set_up_of_a_real_program_is_named(stack, name, tmp_path, capsys):
    if not PROGRAMS[stack]:
        pytest.skip(f"no program of {stack} is named")
    one = DATA[stack]["broken"][name]
    async with autopilot_program(stack, one["set"], tmp_path) as (_, url):
        rules = await asyncio.to_thread(examined, capsys, "--link", url)
    assert rules >= set(one["rules"])


@pytest.mark.timeout(300)
@pytest.mark.parametrize("stack", PROGRAMS)
async def test_a_real_program_is_mended_and_the_change_undone(stack, tmp_path, capsys):
    if not PROGRAMS[stack]:
        pytest.skip(f"no program of {stack} is named")
    name = "cannot flee a rising deck"
    one, undo = DATA[stack]["broken"][name], tmp_path / "undo.json"
    every = {rule for other in DATA[stack]["broken"].values() for rule in other["rules"]}
    wrong = {*one["rules"], *OWN[stack]}
    async with autopilot_program(stack, one["set"], tmp_path) as (_, url):
        assert await asyncio.to_thread(examined, capsys, "--link", url) & every == wrong
        assert await asyncio.to_thread(main, ["doctor", "--link", url, "--fix", "--yes", "--undo-file", str(undo)]) in (0, 1)
        assert not await asyncio.to_thread(examined, capsys, "--link", url) & every
        assert await asyncio.to_thread(main, ["doctor", "--link", url, "--undo", str(undo), "--yes"]) == 0
        assert await asyncio.to_thread(examined, capsys, "--link", url) & every == wrong
