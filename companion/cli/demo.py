"""`decklander demo`: fly the service against a simulated vehicle in real time, with sockets between.

The vehicle is an AR.Drone in a child process, which sends its video as H.264, or an autopilot in miniature in this one.
"""

from __future__ import annotations

import argparse
import asyncio
import signal
import socket
import sys
import tempfile
from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager, AbstractContextManager, AsyncExitStack, ExitStack, suppress
from pathlib import Path
from typing import Protocol

from msgspec import structs

from companion.base import event_loop
from companion.base.health import Health
from companion.base.mission import FlightOutcome
from companion.base.observer import Observer
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.base.signals import check, ending_signal, more_time
from companion.cli import flight_options, kept_flight
from companion.cli.kept_flight import compared_paths, shown
from companion.cli.options import check_seed, listening, named_wait, option, print_line, print_result, refuse_any
from companion.cli.outputs import REPORT_FOLDER, output
from companion.guidance.pilot import Pilot, make_pilot
from companion.guidance.pilot_operator import PilotOperator
from companion.parts.page.access import make_token
from companion.parts.page.link import certify, network_address, qr_code
from companion.service.assemble import live, make_daemon
from companion.service.daemon import Daemon
from companion.settings.capabilities import has_key, installed_vehicles, require_key, vehicle_kind
from companion.settings.links import HttpSettings, VideoStreamOptions, on_loopback
from companion.settings.load import kept_folder, shipped
from companion.settings.model import Settings
from drivers.clock import SystemClock
from drivers.endpoint import parse_endpoint
from estimator.contracts.errors import BadInput, file_errors, refused
from estimator.contracts.tables import imported
from estimator.contracts.time import MonoNs, seconds_between
from sitl.flight.ending import Ending, Load
from sitl.scenario.scenario import Scenario
from sitl.scenario.scenario import load as load_scenario
from sitl.scenario.settings import replaced_keys
from sitl.world.truth import Truth

_STATION = "udpout://127.0.0.1:14550"
"""Link by which ground stations and `decklander start` find an autopilot in miniature: the usual port."""
_REPORT_S = 7.0
"""Time for the report after SIGTERM, s: service managers and containers kill what has not ended after 10 s."""
_SETTLE_S = 0.5  # time that the simulated vehicle flies on after the service has ended
_PROBE_S = 0.1
"""Time for which the demo continues after the landing, s, so that the recording shows the drone on the ground."""
_LIVE = "foxglove"
"""The key of [http] that serves live data, where its capability is installed."""
_ORDER_EACH_S = 0.2
"""Time between two orders to land, while the first ones are refused, s."""


DESCRIPTION = (
    "Land a simulated AR.Drone on a ship's pad in real time, or with --autopilot rehearse a rig of your own: its settings, "
    "camera, pad, limits and page, beside an autopilot in miniature. The landing service flies it through sockets. Exit code 0 "
    "if it landed on the pad, else 1. If the machine is too slow to fly in real time, a line at the end says so, with figures."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    names = ", ".join(shipped("scenarios"))
    option(parser, "--scenario FILE", f"scenario file, or the name of a shipped one ({names}; default: demo)", default="demo")
    option(parser, "--ardrone1", "fly an AR.Drone 1.0 with its camera of 176x144 px, whatever the scenario says")
    flown = "fly this autopilot in miniature instead of an AR.Drone; other terminals reach it by --station"
    option(parser, "--autopilot", flown, choices=("arducopter", "px4"))
    flight_options.add_settings(parser)
    option(parser, "--station URL", f"link of the autopilot to ground stations, doctor and start (default: {_STATION})")
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
    if args.ardrone1:
        vehicle_kind("ardrone")  # it is refused where that is not installed
    in_child = next((kind.demo for kind in installed_vehicles() if kind.demo), "")
    args.autopilot = args.autopilot or (None if in_child else "arducopter")
    alone = "--config, --set and --station go with --autopilot: the AR.Drone flies by the profile sim"
    refuse_any(
        (args.autopilot is None and (args.config or args.set or args.station), alone),
        (args.autopilot is not None and args.ardrone1, "--ardrone1 does not go with --autopilot"),
    )
    scenario = load_scenario(args.scenario)
    with more_time(_REPORT_S), tempfile.TemporaryDirectory(prefix="decklander-") as folder, ExitStack() as beside:
        drone: DemoVehicle
        replaced: Sequence[str] = ()
        if args.autopilot is None:
            drone = imported(in_child)(args.scenario, scenario, args.seed, Path(folder) / "truth.jsonl", first=args.ardrone1)
        else:
            drone, replaced = _miniature(args, scenario)
        place = _place(args, drone.settings.http)
        beside.enter_context(drone.rendering())
        return event_loop.run(_demo(args, drone, replaced, place, Path(folder)))


class DemoVehicle(Protocol):
    """A simulated vehicle, as the demo flies it once."""

    scenario: Scenario
    settings: Settings
    """Settings of the service, without the vehicle's ports."""
    frames_due: int
    """Numbers of frames that it had to send and sent; known after it has ended, like `stood_still_s`."""
    frames_sent: int
    stood_still_s: float

    def rendering(self) -> AbstractContextManager[None]:
        """Prepare what makes its frames, before there is an event loop."""
        ...

    def flying(self) -> AbstractAsyncContextManager[Settings]:
        """Let it fly, and give the settings with its ports."""
        ...

    def observers(self, pilot: Pilot, health: Health) -> Sequence[Observer]:
        """Return its observers of the service."""
        ...

    def serve(self, daemon: Daemon) -> None:
        """Serve the daemon with what does not come by its ports."""
        ...

    def truth(self) -> Sequence[Truth]:
        """Return the true states that a recording keeps, in order of time; call it after its end."""
        ...


def _miniature(args: argparse.Namespace, scenario: Scenario) -> tuple[DemoVehicle, Sequence[str]]:
    """Return the autopilot in miniature beside the settings of the command, and their keys that the world replaced.

    Raises:
        BadInput: as `companion.cli.flight_options.chosen`, and as `Rehearsal`; or nobody is to take the vehicle off the pad.
    """
    from sitl.emulators.autopilots.stand_in.rehearsal import Rehearsal  # it loads MAVLink, which an AR.Drone does not need

    given = flight_options.chosen(args, scenario, by_autopilot=True)
    station = args.station or _STATION
    with refused("--station", BadInput):
        parse_endpoint(station)
    with refused(args.scenario, BadInput):
        world = Rehearsal(given.scenario, args.seed, given.settings, args.autopilot, station)
    if world.stands and args.page is None:
        raise BadInput(f"{args.scenario}: the vehicle stands on the pad: give --page, and order the take-off there")
    return world, given.replaced


async def _demo(args: argparse.Namespace, drone: DemoVehicle, replaced: Sequence[str], place: HttpSettings, folder: Path) -> int:
    clock, token, scenario = SystemClock(), make_token(), drone.scenario
    async with AsyncExitStack() as flying:
        with named_wait("starting the simulated vehicle"):
            settings = await flying.enter_async_context(drone.flying())
        settings = _with_http(settings, args, place, folder, token)
        if args.video is not None:
            with refused("--video", ValueError):
                settings = structs.replace(settings, video_stream=VideoStreamOptions(to=args.video))
        own = (*replaced, *replaced_keys(drone.settings, settings))
        sys.stderr.write(flight_options.notice(args.config, own))
        pilot, health = make_pilot(settings, shadows=compared_paths()), Health(clock)
        began, facts = clock.now(), {"kind": "demo"}
        facts |= {} if args.autopilot is None else {"autopilot": args.autopilot, "binary": "in miniature"}
        with kept_flight.keeping(args, settings, scenario.title, "pixels", facts, live=True) as kept:
            limit_s = scenario.duration_limit_s if args.page is None else None
            with shown(quiet=args.json) as progress:
                observers = [*drone.observers(pilot, health), *kept.observers, *progress]
                daemon = make_daemon(settings, pilot, clock=clock, observers=observers, once=args.page is None, health=health)
                if kept.on_start is not None:
                    kept.on_start(health)
                orders = args.page is None and settings.guidance.start != "automatic"
                drone.serve(daemon)
                outcome = await _flown(daemon, pilot, settings.http, token, limit_s, orders=orders)
                stopped = ending_signal() is not None
                ended = clock.now()
                await asyncio.sleep(_SETTLE_S)
                await flying.aclose()
            truth = drone.truth()
            for one in truth:
                kept.keep(one)
            ending = _ending(args, outcome, seconds_between(began, ended), truth, health, drone)
            if stopped:
                ending = structs.replace(ending, without_outcome="stopped by a person")
            report = kept.end(ending, ending.duration_s, "real time")
    print_result(args, ending.as_json(), f"{ending.in_words()}\n{report}")
    if ending_signal() == signal.SIGTERM:
        check()
    return 0 if ending.on_pad and not kept.incomplete else 1


async def _flown(
    daemon: Daemon, pilot: Pilot, http: HttpSettings, token: str, limit_s: float | None, *, orders: bool
) -> FlightOutcome | None:
    """Fly until the landing has ended; return its outcome, None if the time ran out or a person stopped it.

    Args:
        orders: whether the landing is ordered here; a person does it otherwise, or the settings.
    """
    try:
        async with asyncio.timeout(limit_s), asyncio.TaskGroup() as group:
            beside = [group.create_task(_announce(http, token))]
            beside += [group.create_task(_order(pilot))] if orders else []
            outcome = await live(daemon, pilot)
            for task in beside:
                task.cancel()
    except TimeoutError:
        return None
    return outcome


async def _order(pilot: Pilot) -> None:
    """Order the landing as soon as the vehicle can be flown."""
    operator = PilotOperator(pilot, OrderSender(OrderSource.SIGNAL), SystemClock())
    while pilot.vehicle is None or operator.order(OperatorOrder.BEGIN) is not None:  # noqa: ASYNC110 - no event says it
        await asyncio.sleep(_ORDER_EACH_S)


def _ending(
    args: argparse.Namespace,
    outcome: FlightOutcome | None,
    duration_s: float,
    truth: Sequence[Truth],
    health: Health,
    drone: DemoVehicle,
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
        option(parser, spec, meaning, nargs="?", const="")


def _with_http(settings: Settings, args: argparse.Namespace, place: HttpSettings, folder: Path, token: str) -> Settings:
    """Return the settings with the page, live data, both or neither on a port.

    With a page the token is needed, and the approach waits for the operator: a browser that opens the page shows it from its
    beginning.

    Args:
        folder: where the token is written; its user's alone.
    """
    if args.page is None and args.foxglove is None:
        return structs.replace(settings, http=place)
    token_file = folder / "page.token"
    token_file.touch(0o600)
    token_file.write_text(token)
    page, live, endpoint = args.page is not None, args.foxglove is not None, "https" if place.certificate_file else "http"
    given = str(token_file) if page else ""
    shown_live = {_LIVE: live} if has_key(f"http.{_LIVE}") else {}
    http = structs.replace(place, endpoint=endpoint, token_file=given, page=page, **shown_live)
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


def _place(args: argparse.Namespace, usual: HttpSettings) -> HttpSettings:
    """Return where page and live data are served; refuse addresses of others, and what is taken.

    Args:
        usual: where they are without an address.
    """
    option, given = ("--page", args.page) if args.page is not None else ("--foxglove", args.foxglove)
    if given is None:
        return structs.replace(usual, endpoint="off")
    if args.foxglove is not None:
        require_key(f"http.{_LIVE}", "--foxglove")
    given = given or f"{usual.host}:{usual.port}"
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
    certificate, key = secured
    return structs.replace(usual, endpoint="off", host=host, port=port, token_file="", certificate_file=certificate, key_file=key)


def _secured(host: str) -> tuple[str, str]:
    """Return the files of this computer's certificate for an address and of its key, which are kept: a phone is asked once."""
    if (kept := kept_folder()) is None:
        raise BadInput("--page: there is no home to keep a certificate in: set XDG_CACHE_HOME")
    certificate, key = (kept / "page" / f"{host}{ending}" for ending in (".crt", ".key"))
    with file_errors(str(certificate.parent)):
        certificate.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    certify(host, certificate, key)
    return str(certificate), str(key)
