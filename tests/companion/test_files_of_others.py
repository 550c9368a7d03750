"""Files that others made: pipes, devices, bombs of size, depth, time and memory, given to each command that reads such files."""

import gzip
import json
import lzma
import os
import resource
import signal
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.cli.main import main
from companion.tools.calibrate import guide
from companion.tools.pads import foreign
from companion.tools.pads.svg import read_svg
from drivers.confined import in_child
from drivers.files import Largest, bytes_of, opened, refuse_special, seen_in
from estimator.contracts.errors import BadInput

COMMANDS = {
    "pad import": "pad import {} --size-mm 500 --out {out}.toml",
    "pad import, a board": "pad import {}.json --out {out}.toml",
    "pad import, tags": "pad import {}.yaml --out {out}.toml",
    "pad check": "pad check {}",
    "record import": "record import {} --config {settings} --output {out}.mcap",
    "record cut": "record cut {} --output {out}.mcap",
    "config import": "config import {} --out {out}.toml",
    "config check": "config check {}",
    "replay": "replay {}",
    "report": "report {} --output {out}.html",
    "detect": "detect {}.png --camera sim",
    "detect, attitudes": "detect {picture} --camera sim --attitude {}",
    "detect, a video": "detect {}.mp4 --camera sim",
    "calibrate camera": "calibrate camera {}.png --out {out}.toml",
    "doctor": "doctor {}",
    "doctor, a snapshot": "doctor --snapshot {}",
}


@pytest.fixture(autouse=True)
def no_command_waits() -> Iterator[None]:
    """End a test whose command waits for what nobody writes."""

    def late(*_: object) -> None:
        raise AssertionError("it waits")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def refusal(command: str, given: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command with a file and return its error: one line."""
    text = COMMANDS[command].replace("{}", str(given)).replace("{out}", str(tmp_path / "made"))
    text = text.replace("{settings}", "sim").replace("{picture}", str(tmp_path / "a.png"))
    code = main(text.split())
    error = capsys.readouterr().err
    assert code in (1, 2), error
    assert error.count("\n") >= 1
    assert "Traceback" not in error
    return error


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_a_pipe_or_a_device_is_refused_and_waited_for_by_no_command(command, kind, tmp_path, capsys) -> None:
    (tmp_path / "a.png").write_bytes(png(4, 4))
    ending = COMMANDS[command].partition("{}")[2].partition(" ")[0]
    path = tmp_path / f"strange{ending}"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    error = refusal(command, tmp_path / "strange", tmp_path, capsys)
    assert "not a file, but a device or a pipe" in error


WRAPPINGS = {
    "gzip": gzip.compress(b"time_s,roll_deg,pitch_deg\n"),
    "zip": b"PK\x03\x04\x14\0",
    "xz": lzma.compress(b"a"),
    "zstd": b"\x28\xb5\x2f\xfd\x24",
    "HEIC": b"\0\0\0\x24ftypheic\0\0\0\0",
    "AVIF": b"\0\0\0\x1cftypavif\0\0\0\0",
    "a Mac keeps": b"\0\x05\x16\x07\0\x02\0\0Mac OS X        \0\x02",
    "PDF": b"%PDF-1.7\n",
    "web page": b"\n<!DOCTYPE html>\n<html>",
    "office program": b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1",
    "tar archive": bytes(257) + b"ustar\x0000",
    "Git LFS": b"version https://git-lfs.github.com/spec/v1\n",
    "empty": b"",
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("what", WRAPPINGS)
def test_what_is_packed_wrapped_or_empty_is_named_by_each_command(command, what, tmp_path, capsys) -> None:
    (tmp_path / "a.png").write_bytes(png(640, 360))
    ending = COMMANDS[command].partition("{}")[2].partition(" ")[0]
    (tmp_path / f"wrapped{ending}").write_bytes(WRAPPINGS[what])
    error = refusal(command, tmp_path / "wrapped", tmp_path, capsys)
    if what != "empty" or command not in ("config check", "config import", "pad check"):  # these say which keys they lack
        assert what in error


def test_what_a_system_keeps_beside_files_is_not_seen_in_a_folder(tmp_path: Path) -> None:
    for name in ("b.jpg", "a.jpg", "._a.jpg", ".DS_Store"):
        (tmp_path / name).write_bytes(WRAPPINGS["a Mac keeps"])
    (tmp_path / "c.jpg").mkdir()
    assert [path.name for path in seen_in(tmp_path)] == ["a.jpg", "b.jpg"]
    assert guide.files_of([tmp_path]) == seen_in(tmp_path)


def png(width: int, height: int) -> bytes:
    """Return a black PNG of a size, packed as far as it goes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    rows = zlib.compress(bytes(min(height * (1 + (width + 7) // 8), 10_000_000)), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="100mm" viewBox="0 0 100 100">{}</svg>'
SLOW = SVG.format(
    '<filter id="a" x="-9" y="-9" width="99" height="99">'
    + '<feTurbulence baseFrequency="9" numOctaves="99999999"/>' * 50
    + '</filter><rect width="100" height="100" filter="url(#a)"/>'
)
NESTED = SVG.format("<g>" * 100_000 + "</g>" * 100_000)
DEEP = '{"a":' * 20_000 + "1" + "}" * 20_000


@pytest.mark.parametrize(
    ("command", "name", "content", "said"),
    [
        ("pad import", "a.svg", NESTED, "nested too deep"),
        ("pad import", "a.png", png(60_000, 60_000), "60000x60000 px"),
        ("pad import", "a.svg", " " * 2_100_000, "such a file has at most"),
        ("pad import, a board", "a", DEEP, "no landing-target.json"),
        ("pad import, tags", "a", "? [1, 2]\n: 3\n", "YAML"),
        ("pad import, tags", "a", "[" * 20_000, "YAML"),
        ("pad import, tags", "a", "x: " + "y" * 300_000, "such a file has at most"),
        ("config import", "a.json", DEEP, "no settings that are read"),
        ("config import", "a.json", "[" * 100_000, "no settings that are read"),
        ("config check", "a.toml", "a = " + "[" * 100_000, "not valid TOML"),
        ("doctor, a snapshot", "a.json", DEEP, "no snapshot"),
        ("replay", "a.mcap", DEEP, "not an MCAP file"),
    ],
)
def test_a_bomb_of_depth_or_size_is_refused_in_one_line(command, name, content, said, tmp_path, capsys) -> None:
    if "tags" in command:
        pytest.importorskip("ruamel.yaml")
    ending = COMMANDS[command].partition("{}")[2].partition(" ")[0]
    (tmp_path / f"{name}{ending}").write_bytes(content.encode() if isinstance(content, str) else content)
    assert said in refusal(command, tmp_path / name, tmp_path, capsys)


def test_a_drawing_that_would_never_be_done_ends_when_its_time_is_over() -> None:
    with pytest.raises(BadInput, match=r"a.svg: not read within 0.5 s"):
        in_child(foreign.__name__, "crisp", SLOW.encode(), "a.svg", most_s=0.5)


def test_a_drawing_that_takes_all_memory_ends_its_own_process_alone() -> None:
    huge = SVG.format('<rect width="9" height="9"/>').replace("100mm", "30000px")
    with pytest.raises(BadInput, match="takes more than 100 MiB of memory"):
        in_child(foreign.__name__, "blended", huge.encode(), "a.svg", most_bytes=100 << 20)


def test_names_that_unfold_to_a_billion_end_in_one_line() -> None:
    pytest.importorskip("ruamel.yaml")
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 10)]
    with pytest.raises(BadInput, match=r"tags\.yaml: "):
        in_child(foreign.__name__, "yaml", "\n".join(lines).encode(), "tags.yaml", most_s=2.0, most_bytes=60 << 20)


def test_an_honest_drawing_and_board_come_back_whole() -> None:
    drawing = read_svg(SVG.format('<rect x="20" y="20" width="60" height="60" fill="#f00"/>'), "a.svg")
    pixels = drawing.rendered(0.0, 0.0, (100, 100), 100.0 / drawing.width, crisp=True)
    assert pixels.shape == (100, 100, 4)
    assert tuple(pixels[50, 50]) == (0, 0, 255, 255)
    pytest.importorskip("ruamel.yaml")
    assert json.loads(in_child(foreign.__name__, "yaml", b"a: [1, 2.5, x]", "a.yaml")) == {"a": [1, 2.5, "x"]}


def test_a_plain_file_is_read_whole_and_a_larger_one_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"x" * Largest.BOARD.most_bytes)
    assert len(bytes_of(path, Largest.BOARD)) == Largest.BOARD.most_bytes
    with path.open("ab") as file:
        file.write(b"y")
    for door in (bytes_of, opened, refuse_special):
        with pytest.raises(BadInput, match=r"--board a: 200001 bytes; such a file has at most 200000"):
            door(path, Largest.BOARD, "--board a")
    with pytest.raises(BadInput, match="Is a directory"):
        bytes_of(tmp_path, Largest.BOARD)
    with pytest.raises(BadInput, match="null"):
        bytes_of(Path("a\0b"), Largest.BOARD)
    assert bytes_of(Path("/proc/self/status"), Largest.SETTINGS).startswith(b"Name"), "a file of the kernel has no size"


def test_a_recording_of_any_size_goes_through_the_door(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        file.truncate(20 << 30)
    with opened(path, Largest.RECORDING) as file:
        assert file.read(4) == bytes(4)
    assert path.stat().st_size > Largest.LOG.most_bytes


def test_a_command_that_reads_files_of_others_leaves_memory_to_the_machine() -> None:
    code = (
        "import resource, sys; from companion.cli import main;"
        "main._run = lambda *_: print(resource.getrlimit(resource.RLIMIT_DATA)[0]);"
        "sys.argv = ['decklander', sys.argv[1]]; main.signals.leave = lambda code: 0; main.main()"
    )
    limits = {
        command: int(subprocess.run([sys.executable, "-c", code, command], capture_output=True, check=True).stdout)
        for command in ("pad", "run")
    }
    of_machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert 0.5 * of_machine < limits["pad"] < 0.9 * of_machine
    assert limits["run"] == resource.getrlimit(resource.RLIMIT_DATA)[0], "the service is bounded by its unit"
