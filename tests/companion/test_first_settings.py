"""`decklander start` and what a person reads first: settings that load, a QR code that reads back, help, carets, completion."""

import io
import logging
import re
import socket
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from companion.cli import kept_flight, start
from companion.cli.commands import COMMANDS
from companion.cli.main import main, pointed
from companion.cli.options import WorkProgress
from companion.parts.ardrone import answering
from companion.parts.page.link import qr_code
from companion.settings.load import load
from drivers.ardrone import navdata
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import mav
from estimator.contracts.time import MonoNs
from tests.support.mqtt_service import decision


@pytest.mark.parametrize(
    ("vehicle", "where"), [*product(start.VEHICLES, sorted(start.PLACES)[:1]), *product(sorted(start.VEHICLES)[:1], start.PLACES)]
)
def test_the_file_is_short_commented_good_and_never_overwritten(vehicle, where, tmp_path, capsys):
    out, camera = tmp_path / "rig.toml", "rtsp://deck/1" if vehicle == "px4" else "usb"
    words = ["start", "--yes", "--no-doctor", "--vehicle", vehicle, "--where", where, "--camera", camera, "--out", str(out)]
    assert main([*words, "--page", "127.0.0.1"]) == 0
    text = out.read_text()
    assert len(text.splitlines()) <= 40
    assert text.count("#") >= 4
    assert (vehicle == "px4") is ('source = "stream"' in text)
    assert load(out).limits.height_max_m == tomllib.loads(text)["limits"]["height_max_m"]
    token = tmp_path / "rig.token"
    assert token.stat().st_mode & 0o777 == 0o600
    assert f"http://127.0.0.1:8480/#token={token.read_text().strip()}" in capsys.readouterr().out
    assert main(words) == 2
    assert out.read_text() == text


@pytest.mark.parametrize("page", ["8481", "127.0.0.1:8481", "localhost:8481"])
def test_a_page_is_named_by_its_port_its_address_or_both(page, tmp_path):
    out = tmp_path / "rig.toml"
    assert main(["start", "--yes", "--no-doctor", "--vehicle", "sim", "--page", page, "--out", str(out)]) == 0
    assert (load(out).http.host, load(out).http.port) == ("127.0.0.1", 8481)


def test_the_units_settings_name_its_credentials(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr(start, "_UNIT_FOLDER", tmp_path / "etc")
    monkeypatch.setattr(start, "_UNIT_STORE", tmp_path / "credstore")
    (tmp_path / "etc").mkdir()
    words = "start --yes --vehicle sim --page 127.0.0.1 --out"
    assert main([*words.split(), str(tmp_path / "etc/rig.toml")]) == 1, "no drone is there"
    assert load(tmp_path / "etc/rig.toml").http.token_file == "credential:page"
    token = tmp_path / "credstore/decklander.page"
    assert token.stat().st_mode & 0o777 == 0o600
    output = capsys.readouterr().out
    assert f"#token={token.read_text().strip()}" in output
    assert "systemctl start decklander" in output
    assert "first:              start the simulated drone" in output


@pytest.fixture
def copter(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Send a PX4's HEARTBEAT to a port that `start` listens on, and RC_CHANNELS: channel 7 is flipped once answered."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    monkeypatch.setattr(start, "_UDP_PORTS", (port,))
    monkeypatch.setattr(start, "_SERIAL", ())
    monkeypatch.setattr(answering, "_PORT", 1)
    monkeypatch.setitem(start.ANSWERING, "ardrone2", replace(start.ANSWERING["ardrone2"], host="127.0.0.1"))
    codec, over = Codec(1, 1), threading.Event()

    def beating() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.setblocking(False)
            n = 0
            while True:
                with suppress(BlockingIOError):
                    n = max(n, len(sender.recv(2048)) > 0)
                n += n > 0
                pulses = [1500, 1500, 1100, 1500, 1000, 0, (1000, 1500, 1990)[min(n // 10, 2)], *[0] * 11]
                beat = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PX4, 0, 0, 0, 3)
                for message in (beat, mav.MAVLink_rc_channels_message(0, 16, *pulses, 255)):
                    sender.sendto(codec.pack(message), ("127.0.0.1", port))
                if over.wait(0.05):
                    return

    thread = threading.Thread(target=beating)
    thread.start()
    yield port
    over.set()
    thread.join()


def test_an_autopilot_on_the_network_is_found(copter: int) -> None:
    assert start.found_vehicles(1.0) == [start.FoundVehicle("px4", f"udpin://0.0.0.0:{copter}")]


def test_a_px4_that_is_taken_for_an_ardupilot_is_named_with_its_page(copter: int, tmp_path: Path, capsys) -> None:
    link = f"udpin://127.0.0.1:{copter}"
    main(["start", "--yes", "--vehicle", "ardupilot", "--link", link, "--out", str(tmp_path / "rig.toml")])
    output = capsys.readouterr().out
    assert f"at {link} is a copter with PX4, not a copter with ArduPilot: docs/px4.md is its page\n" in output
    assert "a pad on the ground below: docs/px4.md\n" in output


@pytest.mark.parametrize("answer", [b"HTTP/1.1 400 Bad Request\r\n", None, navdata.encode(navdata.Navdata(0, 1))])
def test_an_ardrone_is_who_sends_navdata(answer: bytes | None, monkeypatch: pytest.MonkeyPatch, copter: int) -> None:
    """Routers have its address, and some answer on every port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there, socket.create_server(("127.0.0.1", 0)) as open_port:
        there.bind(("127.0.0.1", open_port.getsockname()[1]))
        there.settimeout(20.0)
        monkeypatch.setattr(answering, "_PORT", there.getsockname()[1])

        def answer_once() -> None:
            opening, caller = there.recvfrom(100)
            if answer is not None and opening:
                there.sendto(answer, caller)

        thread = threading.Thread(target=answer_once)
        thread.start()
        names = [one.name for one in start.found_vehicles(1.0)]
        thread.join()
    assert names == (["px4", "ardrone2"] if answer is not None and answer[:4] == b"\x88wfU" else ["px4"])


@pytest.mark.parametrize(("answers", "channel"), [("yes\n\n", 7), ("yes\nno\n", 0), ("\n", 0)])
def test_the_switch_that_moves_is_proposed(answers, channel, copter, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", io.StringIO(answers))
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    words = "start --no-doctor --vehicle px4 --camera usb --where ship --page off --out"
    assert main([*words.split(), str(tmp_path / "rig.toml")]) == 0
    assert load(tmp_path / "rig.toml").operator.switch.channel == channel
    assert load(tmp_path / "rig.toml").pad.file == "thesis", "without a question"
    output, shown = capsys.readouterr().out, "channel 7: low 1000 us: hold, middle 1500 us: stay, high 1990 us: begin"
    assert (shown in output) == answers.startswith("yes")
    assert "pad print thesis --out pad.pdf; others: " in output


def test_a_raspberry_pis_own_camera_is_proposed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start, "libcamera_models", lambda: ["imx708_wide"])
    out = tmp_path / "rig.toml"
    words = "start --yes --no-doctor --vehicle px4 --link udpin://127.0.0.1:14540 --out"
    assert main([*words.split(), str(out)]) == 0
    camera = load(out).camera
    assert (camera.source, camera.device, camera.exposure.driven) == ("libcamera", "imx708_wide", True)


def test_the_code_in_the_terminal_is_read_by_a_phone() -> None:
    address = "https://192.168.1.20:8480/#token=3f2a91c07d5e3f2a91c07d5e3f2a91c0"
    light = {"█": (1, 1), "▀": (1, 0), "▄": (0, 1), " ": (0, 0)}
    rows = re.findall(r"\x1b\[97;40m(.+)\x1b\[0m\n", qr_code(address))  # white on black, whatever the terminal has
    cells = np.array([[light[c][half] for c in row] for row in rows for half in (0, 1)], np.uint8)
    picture = cv2.resize(255 * cells, None, fx=8, fy=8, interpolation=cv2.INTER_NEAREST)
    assert cv2.QRCodeDetector().detectAndDecode(picture)[0] == address


def test_commands_are_shown_by_what_a_person_wants(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main([])
    output = capsys.readouterr().err
    places = [output.index(f"\n{title}\n") for title in ("see it", "fly", "set up", "study", "maintain", "examples")]
    assert places == sorted(places)
    assert all(f"\n  {name} " in output for name in COMMANDS)
    assert "\x1b" not in output


@pytest.mark.parametrize(
    ("text", "message", "row", "mark"),
    [
        ('[vehicle]\nkind = "ardrone"\nhots = "x"\n', "vehicle.hots is not a known key", 3, "hots"),
        ('[vehicle]\nkind = "ardrone\n', "not valid TOML: ... (at line 2, column 16)", 2, "\n"),
        ("[vision]\nthreads = 1\n[camera]\n", "camera.file is missing", 3, "camera"),
    ],
)
def test_the_place_of_a_fault_has_a_caret(text: str, message: str, row: int, mark: str, tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(text)
    place, line, caret, page = pointed(f"{file}: {message}").splitlines()
    assert f"{file}:{row}:" in place
    assert caret.index("^") == (line + "\n").index(mark)
    assert "docs/configuration.md" in page


def test_a_file_that_is_refused_as_a_whole_is_refused_in_one_line_on_a_terminal(tmp_path, monkeypatch, capsys):
    """WHY: the place of the fault was looked for in the file that is too large to be read."""
    (tmp_path / "rig.toml").write_text("#" * 1_000_001)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    assert main(["config", "check", str(tmp_path / "rig.toml")]) == 2
    assert capsys.readouterr().err.endswith("rig.toml: 1000001 bytes; such a file has at most 1000000\n")


def test_shells_complete_every_command_and_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    asked = """
for words in "" "simulate --per" "config refer"; do
  COMP_WORDS=(decklander $words); [ -z "$words" ] && COMP_WORDS+=("")
  COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); _shtab_decklander; echo "${COMPREPLY[@]}"
done"""
    done = subprocess.run(["bash", "-c", capsys.readouterr().out + asked], capture_output=True, text=True, check=True)
    offered = [line.split() for line in done.stdout.splitlines()]
    assert offered == [[*COMMANDS], ["--perception", "--perception-model"], ["reference"]]


def test_progress_stays_in_a_narrow_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(kept_flight.ProgressObserver, "_columns", lambda self: 40)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    progress = kept_flight.ProgressObserver()
    progress.on_decision(decision(MonoNs(10**9)))
    shown = capsys.readouterr().err.split("\x1b[2K")[1]
    assert 10 < len(shown) < 40


@pytest.mark.parametrize("columns", [40, 140])
def test_progress_shows_no_height_on_the_deck(columns, monkeypatch, capsys):
    """Nothing corrects the estimate there, and it drifts."""
    monkeypatch.setattr(kept_flight.ProgressObserver, "_columns", lambda self: columns)
    progress = kept_flight.ProgressObserver()
    for k, phase in enumerate(("commit", "landed", "landed by others")):
        progress.on_decision(decision(MonoNs(10**9 * (1 + k)), phase))
    above, *down = capsys.readouterr().err.splitlines()
    assert " m" in above
    assert [each.split() for each in down] == [["1.0", "s", "landed"], ["2.0", "s", "landed", "by", "others"]]


def test_what_is_logged_takes_the_place_of_progress(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with kept_flight.shown(quiet=False):
        logging.getLogger("drivers").warning("the link is gone")
    assert "\r\x1b[2Kthe link is gone\n" in capsys.readouterr().err


def test_work_announces_itself_and_is_silent_while_it_is_short(capsys: pytest.CaptureFixture[str]) -> None:
    progress = WorkProgress("digging", "holes")
    for done in (0, 5, 9, 10):
        progress.take(done, 10, ", dry")
    WorkProgress("raking", "leaves").take(5, 5)
    WorkProgress("sowing", "seeds").take(0, None)
    assert capsys.readouterr().err == "digging: 0 of 10 holes, dry\ndigging: 10 of 10 holes, dry\nsowing: 0 seeds\n"


@pytest.mark.parametrize("wrong", [("--pad", "nosuch"), ("--camera-file", "nosuch"), ("--link", "serial:nope")])
def test_a_wrong_answer_is_refused_before_anything_is_written(wrong: tuple[str, str], tmp_path: Path, capsys) -> None:
    words = ["start", "--yes", "--no-doctor", "--vehicle", "px4", "--link", "udpin://127.0.0.1:14999", *wrong]
    assert main([*words, "--out", str(tmp_path / "rig.toml")]) == 2
    assert wrong[0] in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_after_a_fault_the_first_thing_to_do_is_to_mend_it(tmp_path: Path, capsys) -> None:
    out = tmp_path / "a rig.toml"
    assert main(["start", "--yes", "--vehicle", "px4", "--link", "udpin://127.0.0.1:0", "--out", str(out)]) in (1, 2)
    *_, steps = capsys.readouterr().out.partition("known faults found\n")
    assert [line.partition(":")[0] for line in steps.split("\n") if line][:3] == ["first", "pad", "then"]
    assert f"'{out}'" in steps
    assert "takeoff" not in steps
