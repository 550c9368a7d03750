"""`decklander demo`: run the simulated drone in a child process and the service in this one, with sockets and H.264 between."""

import argparse
import asyncio
import json
import signal
import socket
import sys
import tempfile
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path

from msgspec import Struct, structs

from companion.base import event_loop
from companion.base.health import Health
from companion.base.mission import FlightOutcome
from companion.base.signals import check, ending_signal, more_time
from companion.cli import kept_flight
from companion.cli.kept_flight import compared_paths, shown
from companion.cli.options import check_seed, listening, named_wait, option, print_line, print_result
from companion.cli.outputs import REPORT_FOLDER, output
from companion.guidance.pilot import Pilot, make_pilot
from companion.parts.page.access import make_token
from companion.parts.page.link import certify, network_address, qr_code
from companion.service.assemble import live, make_daemon
from companion.service.daemon import Daemon
from companion.settings.capabilities import require_key
from companion.settings.links import HttpSettings, VideoStreamOptions, on_loopback
from companion.settings.load import kept_folder, load, shipped
from companion.settings.model import CameraSettings, PadSettings, Settings
from drivers.clock import SystemClock
from drivers.pyav import has_pyav
from estimator.contracts.errors import BadInput, Recoverable, file_errors, refused
from estimator.contracts.time import MonoNs, seconds_between
from sitl.ardrone.state import GENERATIONS
from sitl.emulators.ardrone.truth_log import read as read_truth
from sitl.flight.ending import Ending, Load
from sitl.scenario.scenario import Scenario, camera_model, with_ardrone1
from sitl.scenario.scenario import load as load_scenario
from sitl.world.truth import Truth

_READY_S = 120.0  # longest time until the simulated vehicle has started
_REPORT_S = 7.0
"""Time for the report after SIGTERM, s: service managers and containers kill what has not ended after 10 s."""
_SETTLE_S = 0.5  # time that the simulated vehicle flies on after the service has ended
_PROBE_S = 0.1
"""Time for which the demo continues after the landing, s, so that the recording shows the drone on the ground."""
_LIVE = "foxglove"
"""The key of [http] that serves live data, where its capability is installed."""
_KEEP_EACH = 4
"""Every fourth sample of the truth is kept: it comes at 100 Hz, and the report needs 25 Hz."""


_WITHOUT_VIDEO = (
    "an AR.Drone 1.0 flies, for PyAV is not installed; for the 2.0 with its sharper camera: pip install 'decklander[video]'"
)
"""Notice where nothing can decode the 2.0's H.264."""


DESCRIPTION = (
    "Land a simulated AR.Drone on a ship's pad in real time. The drone and the sea run in a process of their own; the landing "
    "service flies the drone through UDP and TCP sockets. Exit code 0 if it landed on the pad, else 1. If the machine is too "
    "slow to fly in real time, a line at the end says so, with figures."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    names = ", ".join(shipped("scenarios"))
    option(parser, "--scenario FILE", f"scenario file, or the name of a shipped one ({names}; default: demo)", default="demo")
    option(parser, "--ardrone1", "fly an AR.Drone 1.0 with its camera of 176x144 px, whatever the scenario says")
    option(parser, "--seed N", "seed of all random numbers (default: 1)", default=1)
    output(parser, "--report DIR", "write the report into this folder (default: report)", REPORT_FOLDER, default=Path("report"))
    option(parser, "--no-report", "write no report", dest="report", action="store_const", const=None)
    option(parser, "--json", "print one JSON object instead of progress")
    _add_servers(parser)
    option(
        parser,
        "--video ADDRESS:PORT",
        "send the picture with the estimate drawn over it there, H.264 by RTP, as to a ground station",
    )
    kept_flight.add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    check_seed(args)
    scenario = load_scenario(args.scenario)
    if scenario.vehicle.generation != "1.0" and not args.ardrone1 and not has_pyav():
        sys.stderr.write(f"{_WITHOUT_VIDEO}\n")
        args.ardrone1 = True
    if args.ardrone1:
        scenario = with_ardrone1(scenario)
    GENERATIONS[scenario.vehicle.generation].check_camera(camera_model(scenario))
    with more_time(_REPORT_S):
        return event_loop.run(_demo(args, scenario, _place(args)))


async def _demo(args: argparse.Namespace, scenario: Scenario, place: HttpSettings | None) -> int:
    clock = SystemClock()
    with tempfile.TemporaryDirectory(prefix="decklander-") as folder:
        truth_path = Path(folder) / "truth.jsonl"
        async with AsyncExitStack() as drone:
            with named_wait("starting the simulated drone"):
                child = await drone.enter_async_context(_drone(args.scenario, args.seed, truth_path, args.ardrone1))
            settings = _profile(scenario, child.ports)
            token = make_token()
            if place is not None:
                settings = _with_http(settings, args, place, Path(folder), token)
            if args.video is not None:
                with refused("--video", ValueError):
                    settings = structs.replace(settings, video_stream=VideoStreamOptions(to=args.video))
            pilot = make_pilot(settings, shadows=compared_paths())
            began = clock.now()
            with kept_flight.keeping(args, settings, scenario.title, "pixels", {"kind": "demo"}, live=True) as kept:
                limit_s = scenario.duration_limit_s if args.page is None else None
                with shown(quiet=args.json) as progress:
                    observers = [*kept.observers, *progress]
                    daemon = make_daemon(settings, pilot, clock=clock, observers=observers, once=args.page is None)
                    if kept.on_start is not None:
                        kept.on_start(daemon.health)
                    outcome = await _flown(daemon, pilot, settings.http, token, limit_s)
                    stopped = ending_signal() is not None
                    ended = clock.now()
                    await asyncio.sleep(_SETTLE_S)
                    await drone.aclose()
                truth = read_truth(truth_path)
                for one in (*truth[:-1:_KEEP_EACH], *truth[-1:]):
                    kept.keep(one)
                ending = _ending(args, outcome, seconds_between(began, ended), truth, daemon.health, child)
                if stopped:
                    ending = structs.replace(ending, without_outcome="stopped by a person")
                report = kept.end(ending, ending.duration_s, "real time")
    print_result(args, ending.as_json(), f"{ending.in_words()}\n{report}")
    if ending_signal() == signal.SIGTERM:
        check()
    return 0 if ending.on_pad and not kept.incomplete else 1


async def _flown(daemon: Daemon, pilot: Pilot, http: HttpSettings, token: str, limit_s: float | None) -> FlightOutcome | None:
    """Fly until the landing has ended; return its outcome, None if the time ran out or a person stopped it."""
    try:
        async with asyncio.timeout(limit_s), asyncio.TaskGroup() as group:
            announced = group.create_task(_announce(http, token))
            outcome = await live(daemon, pilot)
            announced.cancel()
    except TimeoutError:
        return None
    return outcome


class _Child(Struct):
    """The report of the simulated drone's process."""

    ports: dict[str, int]
    frames_due: int = 0
    """Numbers of frames that it had to send and sent; known after it has ended, like the next field."""
    frames_sent: int = 0
    stood_still_s: float = 0.0

    def ended(self, said: bytes) -> None:
        """Read its last output; a process that was killed leaves none."""
        for line in said.splitlines():
            with suppress(ValueError):
                words = json.loads(line)
                if words.get("event") == "ended":
                    self.frames_due, self.frames_sent = (words["counters"].get(f"video_{what}", 0) for what in ("due", "sent"))
                    self.stood_still_s = words["stood_still_s"]


@asynccontextmanager
async def _drone(scenario: str, seed: int, truth: Path, ardrone1: bool) -> AsyncIterator[_Child]:
    """Run the simulated drone as a child. It ends with this process, even if killed, since its standard input closes."""
    ports = [f"--{name}-port=0" for name in ("navdata", "video", "at", "control")]
    child = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "sitl.emulators.ardrone.serve", scenario, f"--seed={seed}", f"--truth={truth}", *ports),
        *(["--ardrone1"] if ardrone1 else []),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        process_group=0,  # Ctrl-C is for this process, and the drone ends with the flight
    )
    assert child.stdin is not None
    assert child.stdout is not None
    drone: _Child | None = None
    try:
        try:
            async with asyncio.timeout(_READY_S):
                line = await child.stdout.readline()
        except TimeoutError as why:
            slow = f"the simulated drone did not start within {_READY_S:.0f} s: this machine is busy with something else"
            raise Recoverable(f"{slow}; decklander simulate needs no speed") from why
        if not line:
            raise Recoverable("the simulated drone ended before it was ready; see its output above")
        drone = _Child(json.loads(line)["ports"])
        yield drone
    finally:
        if drone is None:
            child.kill()  # before it is ready it does not see that its standard input closes
        child.stdin.close()
        printed, _ = await child.communicate()
    drone.ended(printed)


def _profile(scenario: Scenario, ports: dict[str, int]) -> Settings:
    """Return the shipped profile `sim` with these ports and the camera and pad of the scenario."""
    settings = load("sim")
    model = scenario.vehicle.generation
    vehicle = structs.replace(settings.vehicle, model=model, **{f"{name}_port": port for name, port in ports.items()})
    service = structs.replace(settings.service, health_period_s=0.0)
    camera, pad = CameraSettings(scenario.camera.file), PadSettings(scenario.pad.file)
    return structs.replace(settings, vehicle=vehicle, camera=camera, pad=pad, service=service)


def _ending(
    args: argparse.Namespace,
    outcome: FlightOutcome | None,
    duration_s: float,
    truth: list[Truth],
    health: Health,
    drone: _Child,
) -> Ending:
    contacts, started = (truth[-1].contacts, truth[0].at) if truth else ((), MonoNs(0))
    delays = health.delays.get("guidance_late")
    late_s = None if delays is None else delays.quantiles(0.5)[0]
    load = Load(drone.frames_due, drone.frames_sent, drone.stood_still_s, health.frames, late_s)
    troubles = [] if health.frames else ["no frame ever came"]
    for connection, (times, why) in health.failures.items():
        troubles.append(f"{connection} failed {'once' if times == 1 else f'{times} times'}: {why}")
    return Ending(
        args.scenario, args.seed, outcome, contacts, duration_s, health.frames, started, load=load, troubles=tuple(troubles)
    )


def _add_servers(parser: argparse.ArgumentParser) -> None:
    port = str(HttpSettings().port)
    page = (
        "serve the operator page, by TLS on an address of this computer for phones, and print its link; the landing begins by a "
        f"button there, and the flight goes on until Ctrl-C (default: 127.0.0.1:{port})"
    )
    live = (
        "serve the flight live to Foxglove or Lichtblick on loopback and print the address; with --page on the page's port "
        f"(default port: {port})"
    )
    for spec, meaning in (("--page ADDRESS", page), ("--foxglove PORT", live)):
        option(parser, spec, meaning, nargs="?", const=port)


def _with_http(settings: Settings, args: argparse.Namespace, place: HttpSettings, folder: Path, token: str) -> Settings:
    """Return the settings with the page, live data or both on a port.

    With a page the token is needed, and the approach waits for the operator: a browser that opens the page shows it from its
    beginning.

    Args:
        folder: where the token is written; its user's alone.
    """
    token_file = folder / "page.token"
    token_file.touch(0o600)
    token_file.write_text(token)
    page, live, endpoint = args.page is not None, args.foxglove is not None, "https" if place.certificate_file else "http"
    given = str(token_file) if page else ""
    served = structs.asdict(place) | {"endpoint": endpoint, "token_file": given, "page": page}
    http = structs.replace(settings.http, **served, **({_LIVE: live} if hasattr(settings.http, _LIVE) else {}))
    return structs.replace(
        settings, http=http, guidance=structs.replace(settings.guidance, start="signal") if page else settings.guidance
    )


async def _announce(http: HttpSettings, token: str) -> None:
    """Print the addresses of the page and of live data as soon as they answer."""
    if http.endpoint == "off":
        return
    while True:
        with suppress(OSError):
            _, writer = await asyncio.open_connection(http.host, http.port)
            writer.close()
            break
        await asyncio.sleep(_PROBE_S)
    address = f"{f'[{http.host}]' if ':' in http.host else http.host}:{http.port}"
    secure = "s" if http.endpoint == "https" else ""
    link = f"http{secure}://{address}/#token={token}"
    if http.page:
        print_line(f"operator page: {link}")
    if secure:
        print_line("a browser asks once whether to trust this computer's own certificate")
        sys.stderr.write(qr_code(link) if sys.stderr.isatty() else "")
    if getattr(http, _LIVE, False):
        query = f"?token={token}" if http.page else ""
        print_line(f"live for Foxglove (Open connection, Foxglove WebSocket): ws{secure}://{address}/live{query}")


def _place(args: argparse.Namespace) -> HttpSettings | None:
    """Return where page and live data are served, None without both; refuse addresses of others, and what is taken."""
    option, given = ("--page", args.page) if args.page is not None else ("--foxglove", args.foxglove)
    if given is None:
        return None
    if args.foxglove is not None:
        require_key(f"http.{_LIVE}", "--foxglove")
    host, port = listening(given, option)
    secured = "", ""
    if not on_loopback(host):
        if args.page is None:
            raise BadInput(f"{option} {given}: beyond this computer live data are served beside a page: give --page {given} too")
        if network_address(host) != host:
            own = network_address()
            raise BadInput(f"{option}: {host} is no address of this computer" + (f"; {own} is one" if own else ""))
        secured = _secured(host)
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as why:
            raise BadInput(f"{option}: port {port} cannot be used ({why.strerror}); name another: {option} PORT") from why
    return HttpSettings("off", host, port, "", *secured)


def _secured(host: str) -> tuple[str, str]:
    """Return the files of this computer's certificate for an address and of its key, which are kept: a phone is asked once."""
    if (kept := kept_folder()) is None:
        raise BadInput("--page: there is no home to keep a certificate in: set XDG_CACHE_HOME")
    certificate, key = (kept / "page" / f"{host}{ending}" for ending in (".crt", ".key"))
    with file_errors(str(certificate.parent)):
        certificate.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    certify(host, certificate, key)
    return str(certificate), str(key)
