"""Fly the real service while what stands around it fails: python -m benches.chaos [--flights 20] [--first 1] [--vehicle NAME].

Each flight draws one to three events by its seed: readers of the log that stop, terminals that hang up, disks that hang or fill,
links that stall, double or move, brokers that die or say nothing, browsers that stop reading, clocks that are set, ten other
programs on the CPU. The vehicle is the shipped AR.Drone emulator or an autopilot in miniature, over real sockets through a relay
that notes each command as the service sends it. Printed: the longest gap between commands, heartbeats missed, phase at the end,
the loop's lag, lines in the log, and for each event whether the log says its words within ten seconds.

`--worst FILE` writes the ten worst flights as TOML, and `--again FILE` flies those again. `--healthy` flies with nothing failing;
with `--alone` (as root) the service goes before all other programs, as on cores of its own.
"""

import asyncio
import os
import random
import re
import select
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
import urllib.request
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import pairwise
from mmap import mmap
from pathlib import Path

import numpy as np

from benches.dead_man import drone
from benches.options import described, parsed
from drivers.mavlink.dialect import mav
from sitl.emulators.ardrone.truth_log import read as read_truth
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.support.image_files import film
from tests.support.processes import burners, decklander, started
from tests.support.waiting import free_port

NAMED_S = 10.0
GAP_S, LINES = 0.2, 300
"""The required limits: of a gap that is not the link's own, s, and of the lines in the log."""
HOST = "127.0.0.1"
MOSQUITTO = shutil.which("mosquitto", path=os.environ.get("PATH", "") + ":/usr/sbin:/usr/local/sbin")
_TOKEN = "0123456789abcdef" * 4
_WATCHED = ("/operator", f"/live?token={_TOKEN}", f"/metrics?token={_TOKEN}")
_SETPOINT, _HEARTBEAT = 84, 0
_SO_TIMESTAMPNS = 35
"""Socket option of <asm-generic/socket.h>, which Python does not name."""
_OWN_GAP = {"link_stalls", "service_stopped"}
"""Events whose gap is the link's own, or that of the service that was stopped."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that fails from `at_s` on, for `for_s`."""

    kind: str
    at_s: float
    for_s: float


@dataclass(frozen=True, slots=True)
class Chaos:
    """One flight and what happens around it."""

    seed: int
    vehicle: str
    events: tuple[Event, ...]


@dataclass
class Seen:
    """Observations of one flight."""

    commands: list[float] = field(default_factory=list)
    beats: list[float] = field(default_factory=list)
    lines: list[tuple[float, str]] = field(default_factory=list)
    began: float = 0.0
    phase: str = ""
    lag: str = ""
    code: int | None = None
    unsafe: str = ""
    bench_late_s: float = 0.0


class Relay:
    """Passes datagrams between a client and a server, as the link between them is.

    Args:
        server: the server's port.
        heard: gets each datagram, the instant at which the kernel received it, s, and whether it goes to the server. The bench's
            own lateness is not in it.
    """

    def __init__(self, server: int, heard: Callable[[bytes, float, bool], None]) -> None:
        self._server, self._heard = (HOST, server), heard
        self._client: tuple[str, int] | None = None
        self._held: list[tuple[bytes, bool]] = []
        self._front, self._back = self._opened(to_server=True), self._opened(to_server=False)
        self.port = int(self._front.getsockname()[1])
        """The port for clients."""
        self.stalls = self.doubles = False

    def _opened(self, *, to_server: bool) -> socket.socket:
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.bind((HOST, 0))
        made.setblocking(False)
        made.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        asyncio.get_running_loop().add_reader(made.fileno(), self._read, made, to_server)
        return made

    def move(self) -> None:
        """Speak to the server from another port, as after a router's new address."""
        self._shut(self._back)
        self._back = self._opened(to_server=False)

    def close(self) -> None:
        """Close both ends."""
        self._shut(self._front)
        self._shut(self._back)

    @staticmethod
    def _shut(end: socket.socket) -> None:
        asyncio.get_running_loop().remove_reader(end.fileno())
        end.close()

    def _read(self, end: socket.socket, to_server: bool) -> None:
        with suppress(OSError):  # nothing waits, or nobody listens on the other side yet
            while True:
                data, more, _, addr = end.recvmsg(65536, 64)
                if to_server:
                    self._client = addr
                seconds, nanos = struct.unpack("qq", more[0][2])
                self._heard(data, seconds + 1e-9 * nanos - time.time() + time.monotonic(), to_server)
                if self.stalls:
                    self._held = [*self._held[-500:], (data, to_server)]
                else:
                    self._send(data, to_server)

    def flow(self) -> None:
        """End a stall: everything that was held arrives at once."""
        self.stalls, held, self._held = False, self._held, []
        for data, to_server in held:
            self._send(data, to_server)

    def _send(self, data: bytes, to_server: bool) -> None:
        with suppress(OSError):
            for _ in range(1 + self.doubles):
                if to_server:
                    self._back.sendto(data, self._server)
                elif self._client is not None:
                    self._front.sendto(data, self._client)


class Reader:
    """Reads the service's log from a small pipe, and may stop."""

    def __init__(self, seen: Seen) -> None:
        self._end, self.writing = os.pipe()
        self._seen = seen
        self.reads = threading.Event()
        self.reads.set()
        self.thread = threading.Thread(target=self._read, daemon=True)
        self.thread.start()

    def _read(self) -> None:
        rest = b""
        while True:
            self.reads.wait()
            if not select.select([self._end], [], [], 0.2)[0]:
                continue
            data = os.read(self._end, 4096)
            if not data:
                os.close(self._end)
                return
            *lines, rest = (rest + data).split(b"\n")
            self._seen.lines += [(time.monotonic(), line.decode(errors="replace")) for line in lines]


class Around:
    """Everything that stands around one service, and what can happen to it."""

    def __init__(self, folder: Path, seen: Seen, stack: ExitStack, *, alone: bool) -> None:
        self._alone = alone
        self.folder, self.seen, self.stack = folder, seen, stack
        self.reader = Reader(seen)
        self.relays: list[Relay] = []
        self.ports = {name: free_port() for name in ("http", "broker")}
        self.service: subprocess.Popen[str] | None = None
        self.broker: subprocess.Popen[str] | None = None
        self._sockets: list[socket.socket] = []
        (folder / "state").write_bytes(bytes(16))
        with (folder / "state").open("r+b") as file:
            self._state = mmap(file.fileno(), 16)

    def start_broker(self) -> None:
        """Start mosquitto where there is one."""
        if MOSQUITTO is not None:
            conf = self.folder / "mosquitto.conf"
            conf.write_text(f"listener {self.ports['broker']} {HOST}\nallow_anonymous true\n")
            self.broker = self.stack.enter_context(started([MOSQUITTO, "-c", str(conf)], stderr=subprocess.DEVNULL))

    def start_service(self, rig: str) -> None:
        """Start the real service with everything on."""
        (self.folder / "token").write_text(_TOKEN)
        (self.folder / "token").chmod(0o600)
        disk = self.folder / "disk"
        disk.mkdir()
        rig += (
            f'[http]\nendpoint = "http"\nport = {self.ports["http"]}\ntoken_file = "{self.folder}/token"\nfoxglove = true\n'
            f'[recorder]\nenabled = true\nfolder = "{disk}/recordings"\nmin_free_mb = 1.0\n'
            f'[mqtt]\ntransport = "tcp"\nhost = "{HOST}"\nport = {self.ports["broker"]}\nspool = "{disk}/spool"\n'
        )
        (self.folder / "rig.toml").write_text(rig)
        environment = {**os.environ, "LD_PRELOAD": str(shim()), "AROUND_STATE": f"{self.folder}/state", "AROUND_DISK": str(disk)}
        self.service = self.stack.enter_context(
            started(
                decklander("run", "--config", str(self.folder / "rig.toml")),
                stdout=self.reader.writing, stderr=self.reader.writing, env=environment,
            )
        )  # fmt: skip
        os.close(self.reader.writing)
        if self._alone:
            os.sched_setscheduler(self.service.pid, os.SCHED_FIFO, os.sched_param(5))

    def metric(self, pattern: str) -> str:
        """Return what a pattern finds in the metrics."""
        address = f"http://{HOST}:{self.ports['http']}/metrics?token={_TOKEN}"
        with suppress(OSError), urllib.request.urlopen(address, timeout=2) as answer:
            found = re.search(pattern, answer.read().decode())
            return found[1] if found else ""
        return ""

    def _set(self, offset: int, form: str, value: int) -> None:
        self._state[offset : offset + struct.calcsize(form)] = struct.pack(form, value)

    def _each(self, act: Callable[[Relay], None]) -> None:
        for relay in self.relays:
            act(relay)

    def _signal(self, number: int) -> None:
        assert self.service is not None
        self.service.send_signal(number)

    def _signal_broker(self, number: int) -> None:
        if self.broker is not None:
            self.broker.send_signal(number)

    def _part(self) -> None:
        """Close what `_stare` opened."""
        for watcher in self._sockets:
            watcher.close()

    def _stare_at_all(self) -> None:
        for path in _WATCHED:
            self._stare(self.ports["http"], path)

    def _stare(self, port: int, path: str) -> None:
        """Open a connection, ask, and read none of the answer."""
        watcher = socket.socket()
        watcher.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        watcher.settimeout(2.0)
        with suppress(OSError):
            watcher.connect((HOST, port))
            watcher.sendall(
                f"GET {path} HTTP/1.1\r\nHost: {HOST}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r\n"
                "Sec-WebSocket-Protocol: foxglove.websocket.v1\r\n\r\n".encode()
            )
        self._sockets.append(watcher)

    @contextmanager
    def happening(self, event: Event) -> Iterator[None]:
        """Let an event last as long as the context."""
        begin, end = self._acts()[event.kind]
        begin()
        try:
            yield
        finally:
            end()

    def _acts(self) -> dict[str, tuple[Callable[[], object], Callable[[], object]]]:
        def nothing() -> None:
            return None

        hogs = ExitStack()
        return {
            "log_reader_stops": (self.reader.reads.clear, self.reader.reads.set),
            "terminal_hangs_up": (lambda: self._signal(signal.SIGHUP), nothing),
            "ctrl_z": (lambda: self._signal(signal.SIGTSTP), nothing),
            "service_stopped": (lambda: self._signal(signal.SIGSTOP), lambda: self._signal(signal.SIGCONT)),
            "disk_hangs": (lambda: self._set(0, "i", 1), lambda: self._set(0, "i", 0)),
            "disk_full": (lambda: self._set(4, "i", 1), lambda: self._set(4, "i", 0)),
            "clock_set": (lambda: self._set(8, "q", 200 * 86400), nothing),
            "link_stalls": (lambda: self._each(lambda r: setattr(r, "stalls", True)), lambda: self._each(Relay.flow)),
            "link_doubles": (
                lambda: self._each(lambda r: setattr(r, "doubles", True)),
                lambda: self._each(lambda r: setattr(r, "doubles", False)),
            ),
            "link_moves": (lambda: self._each(Relay.move), nothing),
            "broker_dies": (lambda: self._signal_broker(signal.SIGKILL), self.start_broker),
            "broker_says_nothing": (
                lambda: self._signal_broker(signal.SIGSTOP),
                lambda: self._signal_broker(signal.SIGCONT),
            ),
            "browsers_stop_reading": (self._stare_at_all, self._part),
            "cpu_hogs": (lambda: hogs.enter_context(burners(10)), hogs.close),
        }  # fmt: skip


WORDS = {
    "terminal_hangs_up": "hung up",
    "ctrl_z": "Ctrl-Z",
    "service_stopped": "stood still|suspended|held for",
    "disk_hangs": "recorder: the disk has taken nothing|disk",
    "disk_full": "No space left",
    "clock_set": "wall clock was set",
    "link_stalls": "no status|silent|lost|old|heard|no sample|no attitude",
    "broker_dies": "broker|mqtt",
}
"""Patterns that the log must contain for an event. The other events need no action of a person. The log reports a silent broker
after twice the keep-alive interval, and these are shorter."""
KINDS = (
    "log_reader_stops", "terminal_hangs_up", "ctrl_z", "service_stopped", "disk_hangs", "disk_full", "clock_set", "link_stalls",
    "link_doubles", "link_moves", "broker_dies", "broker_says_nothing", "browsers_stop_reading", "cpu_hogs",
)  # fmt: skip
_ALONE = ("disk_hangs", "disk_full", "broker_dies", "broker_says_nothing")
"""Events that exclude others with the same first word: nobody writes to a full disk, so it cannot hang."""


def draw(seed: int, vehicle: str | None) -> Chaos:
    """Return the flight of a seed."""
    rng = random.Random(seed)
    kinds = {kind.split("_")[0] if kind in _ALONE else kind: kind for kind in rng.sample(KINDS, rng.randint(1, 3))}.values()
    events = tuple(Event(kind, round(rng.uniform(1.0, 5.0), 1), round(rng.uniform(3.0, 6.0), 1)) for kind in kinds)
    return Chaos(seed, vehicle or rng.choice(("mavlink", "ardrone")), events)


def shim() -> Path:
    """Return the compiled `around.c`."""
    made = Path(tempfile.gettempdir()) / f"decklander-around-{os.getuid()}.so"
    source = Path(__file__).with_name("around.c")
    if not made.exists() or made.stat().st_mtime < source.stat().st_mtime:
        subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", str(made), str(source), "-ldl"], check=True)
    return made


def grey_video(path: Path) -> None:
    """Write a camera's video in which nothing is to be seen."""
    rng = np.random.default_rng(1)
    film(path, [rng.integers(110, 130, (360, 640, 1), dtype=np.uint8).repeat(3, 2) for _ in range(100)], "mpeg4", 10)


def message_ids(data: bytes) -> Iterator[int]:
    """Yield the ids of the MAVLink 2 messages in a datagram."""
    while len(data) >= 12 and data[0] == 0xFD:
        yield int.from_bytes(data[7:10], "little")
        data = data[12 + data[1] + 13 * (data[2] & 1) :]


async def until(condition: Callable[[], object], what: str, seconds: float = 60.0) -> None:
    """Wait for something to come true.

    Raises:
        TimeoutError: it does not.
    """
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(what)
        await asyncio.sleep(0.05)


async def beside_autopilot(around: Around, stack: ExitStack, happens: Callable[[], Awaitable[None]]) -> None:
    """Fly an autopilot in miniature over the sea, where no pad is in sight, while `happens` lasts."""
    seen, port = around.seen, free_port()

    def heard(data: bytes, now: float, to_service: bool) -> None:
        if not to_service:
            for number in message_ids(data):
                if number in (_SETPOINT, _HEARTBEAT):
                    (seen.commands if number == _SETPOINT else seen.beats).append(now)

    relay = Relay(port, heard)
    around.relays.append(relay)
    grey_video(around.folder / "grey.mp4")
    around.start_service(
        f'[vehicle]\nkind = "mavlink"\nlinks = "udpin://{HOST}:{port}"\n[camera]\nfile = "sim"\nsource = "stream"\n'
        f'device = "{around.folder}/grey.mp4"\nrepeat = true\n[pad]\nfile = "thesis"\n[guidance]\nstart = "signal"\n'
    )
    craft = MiniatureAutopilot()
    async with craft.talking_to(f"udpout://{HOST}:{relay.port}"):
        await until(lambda: seen.beats, "a heartbeat")

        def begun() -> bool:
            craft.send(mav.MAVLink_command_long_message(7, 191, mav.MAV_CMD_DO_PAUSE_CONTINUE, 0, 1, 0, 0, 0, 0, 0, 0))
            return len(seen.commands) > 10

        await until(begun, "its commands")
        await happens()
    sinks = [m.vz for _, m in craft.setpoints if m.vz > 0.05]
    seen.unsafe = f"sinks by {max(sinks):.2f} m/s" if sinks else ""


async def beside_ardrone(around: Around, stack: ExitStack, happens: Callable[[], Awaitable[None]], seed: int) -> None:
    """Let the emulated AR.Drone land on the ship while `happens` lasts."""
    seen, truth = around.seen, around.folder / "truth"
    found = stack.enter_context(drone("demo", seed, truth))
    for name in ("navdata", "at"):

        def heard(data: bytes, now: float, to_drone: bool, is_command: bool = name == "at") -> None:
            if to_drone and is_command:
                seen.commands.append(now)

        relay = Relay(found[name], heard)
        around.relays.append(relay)
        found[name] = relay.port
    keys = "\n".join(f"{name}_port = {port}" for name, port in found.items())
    around.start_service(
        f'[vehicle]\nkind = "ardrone"\nhost = "{HOST}"\n[expert.vehicle]\n{keys}\n[camera]\nfile = "sim"\n'
        '[pad]\nfile = "thesis"\n[vision]\ncolours = "simulator"\n[guidance]\nstart = "automatic"\n'
    )
    await until(lambda: len(seen.commands) > 60, "its commands")
    await happens()
    for contact in read_truth(truth)[-1].contacts:
        if not contact.on_pad:
            seen.unsafe = "touched beside the pad"


async def fly(chaos: Chaos, lasting_s: float, *, alone: bool = False) -> Seen:
    """Fly once and watch for some time; with `alone` the service goes before all other programs."""
    seen = Seen()
    with tempfile.TemporaryDirectory(prefix="decklander-chaos-") as name, ExitStack() as stack:
        around = Around(Path(name), seen, stack, alone=alone)
        around.start_broker()

        async def one(event: Event) -> None:
            await asyncio.sleep(event.at_s)
            with around.happening(event):
                await asyncio.sleep(event.for_s)

        async def bench_late() -> None:
            while True:
                asked = time.monotonic()
                await asyncio.sleep(0.02)
                seen.bench_late_s = max(seen.bench_late_s, time.monotonic() - asked - 0.02)

        async def happens() -> None:
            seen.began = time.monotonic()
            metric = around.metric

            async def scrape() -> None:
                while True:
                    await asyncio.sleep(1.0)
                    await asyncio.to_thread(metric, "loop_lag")

            beside = [asyncio.create_task(bench_late()), asyncio.create_task(scrape())]
            await asyncio.gather(asyncio.sleep(lasting_s), *(one(event) for event in chaos.events))
            for task in beside:
                task.cancel()
            seen.phase = await asyncio.to_thread(metric, r'decklander_phase\{phase="([^"]*)"\} 1')
            lag = [await asyncio.to_thread(metric, rf'name="lag_{which}_s",part="loop"\}} (\S+)') for which in ("p999", "worst")]
            seen.lag = "/".join(f"{1e3 * float(one):.1f}" if one else "?" for one in lag)
            assert around.service is not None
            around.service.send_signal(signal.SIGTERM)
            await until(lambda: around.service is not None and around.service.poll() is not None, "its end", 10.0)
            seen.code = around.service.returncode

        if chaos.vehicle == "mavlink":
            await beside_autopilot(around, stack, happens)
        else:
            await beside_ardrone(around, stack, happens, chaos.seed)
        around.reader.thread.join(1.0)
        around._each(Relay.close)
    return seen


@dataclass(frozen=True, slots=True)
class Row:
    """Verdict on one flight."""

    chaos: Chaos
    gap_s: float
    beats_missed: int
    unnamed: tuple[str, ...]
    seen: Seen

    @property
    def bad(self) -> tuple[float, ...]:
        """Badness for sorting, worst first: unsafe events, ending, events without a report, gap, lines."""
        seen = self.seen
        return bool(seen.unsafe), seen.code != 0, max(0.0, self.gap_s - GAP_S), len(self.unnamed), self.gap_s, len(seen.lines)

    @property
    def good(self) -> bool:
        """True if every requirement holds."""
        seen = self.seen
        return not seen.unsafe and seen.code == 0 and self.gap_s <= GAP_S and not self.unnamed and len(seen.lines) < LINES

    def __str__(self) -> str:
        s, events = self.seen, ", ".join(f"{e.kind} {e.at_s:g}+{e.for_s:g}" for e in self.chaos.events)
        return (
            f"{'ok ' if self.good else 'BAD'} {self.chaos.seed:4d} {self.chaos.vehicle:8s} gap {1e3 * self.gap_s:4.0f} ms, "
            f"beats missed {self.beats_missed}, {s.phase or '?'}, ended {s.code}, lag p99.9/worst {s.lag} ms, bench late "
            f"{1e3 * s.bench_late_s:.0f} ms, {len(s.lines)} lines{', unnamed ' + ' '.join(self.unnamed) if self.unnamed else ''}"
            f"{', UNSAFE ' + s.unsafe if s.unsafe else ''} | {events}"
        )


def judged(chaos: Chaos, seen: Seen) -> Row:
    """Return the row of a flight."""
    began, own = seen.began, [e for e in chaos.events if e.kind in _OWN_GAP]

    def counts(a: float, b: float) -> bool:
        return began <= a and not any(began + e.at_s <= b and a <= began + e.at_s + e.for_s + 2.0 for e in own)

    gap_s = max((b - a for a, b in pairwise(seen.commands) if counts(a, b)), default=float(chaos.vehicle == "mavlink") * 99.0)
    missed = sum(round(b - a) - 1 for a, b in pairwise(seen.beats) if counts(a, b) and b - a > 1.5)
    unnamed = []
    stopped = [(e.at_s, e.at_s + e.for_s) for e in chaos.events if e.kind == "service_stopped"]
    for event in chaos.events:
        if any(begin < event.at_s and event.at_s + event.for_s < end for begin, end in stopped):
            continue  # a stopped service meets nothing of it
        start, end = began + event.at_s, began + event.at_s + event.for_s + NAMED_S
        if (words := WORDS.get(event.kind)) and not any(start <= at <= end and re.search(words, line) for at, line in seen.lines):
            unnamed.append(event.kind)
    return Row(chaos, gap_s, missed, tuple(unnamed), seen)


def as_toml(rows: list[Row]) -> str:
    """Return flights as a file for `--again`."""
    out = []
    for row in rows:
        out.append(f'# {row}\n[[flight]]\nseed = {row.chaos.seed}\nvehicle = "{row.chaos.vehicle}"\nevents = [')
        out += [f'    {{kind = "{e.kind}", at_s = {e.at_s}, for_s = {e.for_s}}},' for e in row.chaos.events]
        out.append("]\n")
    return "\n".join(out)


def of_toml(text: str) -> list[Chaos]:
    """Return the flights of such a file."""
    return [
        Chaos(flight["seed"], flight["vehicle"], tuple(Event(**event) for event in flight["events"]))
        for flight in tomllib.loads(text)["flight"]
    ]


def main() -> int:
    """Fly and print; return 0 if every flight was good."""
    parser = described(__doc__)
    parser.add_argument("--flights", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--vehicle", choices=("mavlink", "ardrone"))
    parser.add_argument("--kind", choices=KINDS, help="fly this event alone")
    parser.add_argument("--lasting", type=float, default=16.0, metavar="SECONDS", help="watch each flight for so long")
    parser.add_argument("--healthy", action="store_true", help="let nothing fail")
    parser.add_argument("--alone", action="store_true", help="let the service go before all other programs (SCHED_FIFO)")
    parser.add_argument("--worst", type=Path, metavar="FILE", help="write the ten worst flights")
    parser.add_argument("--again", type=Path, metavar="FILE", help="fly the flights of a file")
    parser.add_argument("--log", action="store_true", help="print the log of each flight")
    asked = parsed(parser, "--flights 1 --vehicle ardrone --healthy --lasting 2")
    flights = [draw(seed, asked.vehicle) for seed in range(asked.first, asked.first + asked.flights)]
    if asked.again is not None:
        flights = of_toml(asked.again.read_text())
    if asked.kind is not None:
        flights = [Chaos(asked.first, asked.vehicle or "mavlink", (Event(asked.kind, 2.0, 5.0),))]
    if asked.healthy:
        flights = [Chaos(chaos.seed, chaos.vehicle, ()) for chaos in flights]
    rows = []
    for chaos in flights:
        try:
            row = judged(chaos, asyncio.run(fly(chaos, asked.lasting, alone=asked.alone)))
        except (TimeoutError, ExceptionGroup) as why:
            print(f"BAD {chaos.seed:4d} {chaos.vehicle}: waited in vain ({why!r}) | {chaos.events}", flush=True)
            continue
        rows.append(row)
        print(row, flush=True)
        if asked.log:
            print("\n".join(f"      {at - row.seen.began:6.2f} {line}" for at, line in row.seen.lines), flush=True)
    good = sum(row.good for row in rows)
    print(
        f"{good} of {len(flights)} good; longest gap {1e3 * max((r.gap_s for r in rows), default=0):.0f} ms, "
        f"{sum(bool(r.seen.unsafe) for r in rows)} unsafe, {sum(len(r.unnamed) for r in rows)} events unnamed, "
        f"at most {max((len(r.seen.lines) for r in rows), default=0)} lines; load {os.getloadavg()[0]:.1f}"
    )
    if asked.worst is not None:
        asked.worst.write_text(as_toml(sorted(rows, key=lambda r: r.bad, reverse=True)[:10]))
    return 0 if good == len(flights) else 1


if __name__ == "__main__":
    sys.exit(main())
