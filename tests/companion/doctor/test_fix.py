"""`doctor --fix` and `--undo` against both stand-ins on loopback: what is asked, written, read back, refused and undone."""

import asyncio
import io
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from companion.cli import doctor
from companion.tools.doctor import gather, rules_values
from companion.tools.doctor.diagnose import PARAMETERS
from companion.tools.doctor.snapshot import decode
from companion.tools.doctor.undo import UndoFile
from drivers.clock import SystemClock
from drivers.mavlink.dialect import Message
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.vehicle import Stack
from estimator.contracts.errors import BadInput
from sitl.emulators.autopilots.stand_in.arducopter import CopterStandIn
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from sitl.emulators.autopilots.stand_in.px4 import Px4StandIn
from tests.companion.doctor.test_rules import defaults, run_doctor
from tests.support.waiting import free_port, until

HOST = "127.0.0.1"
GOOD = {stack: {r.parameter: r.good for r in rules_values.RULES if r.stack == stack} for stack in ("ArduPilot", "PX4")}


def quiet(stack: str, **wrong: float) -> MiniatureAutopilot:
    """Return an autopilot that stands disarmed on deck, with the parameters of its stand-in and those that are wrong."""
    stand_in = (CopterStandIn if stack == "ArduPilot" else Px4StandIn)(SystemClock())
    own = defaults(stack) | {n: stand_in.parameters.get(n, GOOD[stack].get(n, 0)) for n in PARAMETERS[stack]} | wrong
    kind = Stack.ARDUPILOT if stack == "ArduPilot" else Stack.PX4
    mode = "loiter" if stack == "ArduPilot" else "auto.loiter"
    return MiniatureAutopilot(kind, 1, mode, armed=False, landed_state=1, parameters=own)


@contextmanager
def on_link(fake: MiniatureAutopilot) -> Iterator[str]:
    """Run the autopilot on a thread with a loop of its own; yield the URL of its link."""
    ready, url, stop = threading.Event(), [""], asyncio.Event()
    loops: list[asyncio.AbstractEventLoop] = []

    async def live() -> None:
        loops.append(asyncio.get_running_loop())
        async with fake.talking_to(f"udpin://{HOST}:0"):
            await until(lambda: fake.links is not None and fake.links.all[0].local is not None)
            url[0] = "udpout://{}:{}".format(*fake.links.all[0].local)
            ready.set()
            await stop.wait()

    thread = threading.Thread(target=lambda: asyncio.run(live()))
    thread.start()
    try:
        assert ready.wait(60)
        yield url[0]
    finally:
        loops[0].call_soon_threadsafe(stop.set)
        thread.join(60)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ask every 10 ms, and do not wait for a version that no autopilot here sends."""
    monkeypatch.setattr(doctor, "AutopilotOptions", partial(AutopilotOptions, command_period_s=0.01))
    monkeypatch.setattr(gather, "_VERSION_S", 0.0)


def test_what_is_agreed_to_is_written_and_undone(tmp_path, capsys, monkeypatch):
    fake = quiet("ArduPilot", LAND_SPEED=250.0, GUID_TIMEOUT=0.2, PLND_STRICT=0.0)
    kept = tmp_path / "undo.json"
    with on_link(fake) as url:
        # Warnings in the order of the rules: PLND_STRICT, GUID_TIMEOUT, LAND_SPEED.
        monkeypatch.setattr("sys.stdin", io.StringIO("y\nn\ny\n"))
        code, out = run_doctor(capsys, "--link", url, "--fix", "--undo-file", str(kept))
        assert [fake.parameters[name] for name in ("PLND_STRICT", "GUID_TIMEOUT", "LAND_SPEED")] == [2.0, 0.2, 40.0]
        assert code == 1, "a warning is left"
        assert "set LAND_SPEED 250 -> 40? [y/N]" in out
        assert "LAND_SPEED        250 -> 40: written and read back" in out
        assert f"undo: decklander doctor --link {url} --undo {kept}" in out
        assert [(w.parameter, w.was) for w in decode(kept.read_bytes(), "it", UndoFile, "undo file").written] == [
            ("PLND_STRICT", 0.0), ("LAND_SPEED", 250.0)
        ]  # fmt: skip
        fake.parameters["PLND_STRICT"] = 1.0  # somebody chose otherwise meanwhile
        code, out = run_doctor(capsys, "--link", url, "--undo", str(kept), "--yes")
        assert (fake.parameters["PLND_STRICT"], fake.parameters["LAND_SPEED"]) == (1.0, 250.0)
        assert code == 1
        assert "PLND_STRICT       2 -> 0: NOT written: it was 2 and is 1: somebody else changed it" in out
        _, out = run_doctor(capsys, "--link", url)
        assert out.endswith(f"next: decklander doctor --link {url} --fix sets parameters, each when you agree to it\n")


def test_a_px4_s_integers_and_reals_are_written_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fake = quiet("PX4", EKF2_GPS_CHECK=245 | 512, COM_OF_LOSS_T=10.0, EKF2_HGT_REF=2)
    kept = tmp_path / "undo.json"
    with on_link(fake) as url:
        code, out = run_doctor(capsys, "--link", url, "--fix", "--yes", "--json", "--undo-file", str(kept))
        assert code == 0
        assert (fake.parameters["EKF2_GPS_CHECK"], fake.parameters["COM_OF_LOSS_T"]) == (21 | 512, 1.0)
        results = [json.loads(line) for line in out.splitlines() if line.startswith('{"parameter"')]
        assert {r["parameter"]: r["value"] for r in results} == {"EKF2_GPS_CHECK": 533, "COM_OF_LOSS_T": 1, "EKF2_HGT_REF": 1}
        code, out = run_doctor(capsys, "--link", url, "--undo", str(kept), "--yes")
        assert code == 0
        assert "reboot the autopilot, then examine it again; read at its start: EKF2_HGT_REF" in out
        assert "EKF2_HGT_REF      is 2 already\n" in run_doctor(capsys, "--link", url, "--undo", str(kept), "--yes")[1]
        assert (fake.parameters["EKF2_GPS_CHECK"], fake.parameters["COM_OF_LOSS_T"]) == (245 | 512, 10.0)


@pytest.mark.parametrize("how", [("--fix", "--yes"), ("--write", "w.params")])
def test_where_nothing_listens_nothing_is_in_order(how: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    out = run_doctor(capsys, "--link", f"tcp://{HOST}:{free_port()}", *how, "--seconds", "0.5")[1]
    assert out.endswith("no autopilot was examined: nothing was written\n")


def test_a_refused_write_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fake = quiet("ArduPilot", LAND_SPEED=250.0)
    fake.fixed_parameters = frozenset({"LAND_SPEED"})
    kept = tmp_path / "undo.json"
    with on_link(fake) as url:
        code, out = run_doctor(capsys, "--link", url, "--fix", "--yes", "--undo-file", str(kept))
    assert code == 1
    assert "LAND_SPEED        250 -> 40: NOT written: the autopilot refuses it: it is still 250" in out
    assert not kept.exists(), "there is nothing to undo"


def test_nothing_is_written_while_armed_nor_once_it_arms(tmp_path, capsys, monkeypatch):
    fake = quiet("ArduPilot", LAND_SPEED=250.0)
    fake.armed = True
    kept = tmp_path / "undo.json"
    with on_link(fake) as url:
        with pytest.raises(BadInput, match="while the vehicle is armed"):
            run_doctor(capsys, "--link", url, "--fix", "--yes", "--undo-file", str(kept))
        fake.armed = False

        class ArmsWhileTheQuestionStands:
            def readline(self) -> str:
                fake.armed = True
                return "y\n"

            def isatty(self) -> bool:
                return True

        monkeypatch.setattr("sys.stdin", ArmsWhileTheQuestionStands())
        with pytest.raises(BadInput, match="the vehicle is armed: no parameter was written"):
            run_doctor(capsys, "--link", url, "--fix", "--undo-file", str(kept))
    assert fake.of("PARAM_SET") == []
    assert not kept.exists()


def test_it_is_looked_at_again_before_each_write(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    class ArmsAfterTheFirst(MiniatureAutopilot):
        def _on_param_set(self, m: Message, received: ReceivedMessage) -> None:
            super()._on_param_set(m, received)
            self.armed = True
            self.send(self.heartbeat())

    good = quiet("ArduPilot", LAND_SPEED=250.0, GUID_TIMEOUT=0.2)
    fake = ArmsAfterTheFirst(system=1, armed=False, landed_state=1, parameters=good.parameters)
    with on_link(fake) as url:
        code, out = run_doctor(capsys, "--link", url, "--fix", "--yes", "--undo-file", str(tmp_path / "undo.json"))
    assert code == 1
    assert len(fake.of("PARAM_SET")) == 1
    assert "LAND_SPEED        250 -> 40: NOT written: the vehicle is armed" in out


def test_an_undo_file_of_another_vehicle_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "undo.json"
    kept.write_text('{"autopilot": "PX4", "system": 1, "written": [{"parameter": "COM_OF_LOSS_T", "was": 10, "to": 1}]}')
    other = "it is of PX4, system 1; found is ArduPilot, system 1"
    with on_link(quiet("ArduPilot")) as url, pytest.raises(BadInput, match=other):
        run_doctor(capsys, "--link", url, "--undo", str(kept), "--yes")
    kept.write_text("{}")
    with pytest.raises(BadInput, match="no undo file"):
        run_doctor(capsys, "--link", "udpin://127.0.0.1:0", "--undo", str(kept), "--yes")


def test_a_file_that_exists_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "undo.json"
    kept.write_text("the values before")
    fake = quiet("ArduPilot", LAND_SPEED=250.0)
    with on_link(fake) as url, pytest.raises(BadInput, match="is in the way"):
        run_doctor(capsys, "--link", url, "--fix", "--yes", "--undo-file", str(kept))
    assert kept.read_text() == "the values before"
    assert fake.of("PARAM_SET") == []
