"""`decklander start`: ask for vehicle, camera and place, write a commented settings file, check it and show the page."""

import argparse
import itertools
import selectors
import shlex
import shutil
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from msgspec import Struct

from companion.base import event_loop
from companion.cli import config, doctor
from companion.cli.keys import write_secret
from companion.cli.options import listening, named_wait, option
from companion.cli.outputs import SETTINGS, output
from companion.parts.page.access import make_token
from companion.parts.page.link import certify, network_address, qr_code
from companion.settings.capabilities import answering_vehicles
from companion.settings.load import find_file, pad_of_file, write_whole
from companion.settings.operator import SwitchOptions
from companion.tools.doctor.gather import seen_moving, wait_until
from drivers.camera.camera_process import libcamera_models
from drivers.camera.v4l2 import cameras
from drivers.clock import SystemClock
from drivers.mavlink.autopilot import open_autopilot
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.rc_channels import POSITIONS
from estimator.contracts.errors import BadInput, file_errors, refused

ANSWERING = {one.word: one for one in answering_vehicles()}
"""The vehicles whose address and camera are known."""
VEHICLES = {
    **{word: one.summary for word, one in ANSWERING.items()},
    "ardupilot": "a copter with ArduPilot",
    "px4": "a copter with PX4",
}
_CAMERAS = {word: one.camera_file for word, one in ANSWERING.items()}
_USUAL_VEHICLE = next((word for word, one in ANSWERING.items() if one.searched), "ardupilot")
"""The vehicle where none is named and none answers."""
USUAL_PAD = "thesis"
"""The pad of the examples: an A4 printer prints it in parts."""
PLACES = {"indoors": "a hall, lamps", "outdoors": "daylight, a pad ashore", "ship": "daylight, a pad on a ship"}
_USUAL_LINK, _USUAL_CAMERA = "serial:///dev/ttyAMA0:921600", "usb_640x480"
_UDP_PORTS = (14550, 14540)
_SPEEDS = (921600, 57600, 115200)
_IDENTIFIED_S = 1.5  # time in which an autopilot on a link is recognized
_FLIP_S = 20.0  # time that an operator has to flip the switch
_STACKS = {"ArduPilot": "ardupilot", "PX4": "px4"}
_UNIT_FOLDER, _UNIT_STORE = Path("/etc/decklander"), Path("/etc/credstore")
"""Folders of the unit's settings and of its credentials: it runs as a user of its own, who cannot read root's files."""
_SERIAL = ("/dev/serial/by-id/*", "/dev/serial0", "/dev/ttyAMA0")


Ask = Callable[[str, dict[str, str], str], str]
"""Returns one of some answers, by the name of the question, the answers with their meaning, and the usual one."""


class Answers(Struct, frozen=True):
    """Answers from which the settings file is made."""

    vehicle: str
    link: str
    """MAVLink link of an autopilot; address of a vehicle of its own protocol."""
    camera: str
    """V4L2 device, "libcamera:" and the name of a Raspberry Pi's camera, a stream's address, or "vehicle"."""
    camera_file: str
    pad: str
    place: str
    page: str
    """Address that the page listens on; empty for none."""
    port: int = 8480
    channel: int = 0
    """Channel of the transmitter's switch; 0 for none."""


DESCRIPTION = (
    "Ask for vehicle, camera and place, write a commented settings file, check it, diagnose the setup and "
    "print the operator page's address. Autopilots and cameras are found. An option replaces its question. Exit code: "
    "that of the doctor, or 2 for a wrong answer."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    option(parser, "--vehicle", "vehicle", choices=sorted(VEHICLES))
    option(parser, "--link URL", "MAVLink link of an autopilot, or address of an AR.Drone (default: found)")
    option(parser, "--camera DEVICE", "camera: a V4L2 path or a part of its name, libcamera:NAME or an address (default: found)")
    option(parser, "--camera-file FILE", "camera file of yours (default: a shipped one to begin with)")
    option(parser, "--pad NAME", f"pad: one of decklander pad list, or a file of yours (default: {USUAL_PAD})")
    option(parser, "--where", "place of the flights", choices=sorted(PLACES))
    option(
        parser, "--page ADDRESS", "address, port or both for the operator page: 127.0.0.1, one of this computer's by TLS, or off"
    )
    option(parser, "--switch CHANNEL", "channel of a switch on the transmitter that gives orders; 0 for none", type=int)
    output(parser, "--out FILE", "file to write (default: rig.toml)", SETTINGS, default=Path("rig.toml"))
    option(parser, "--yes", "ask nothing: take what is found or usual")
    option(parser, "--no-doctor", "skip the diagnosis")


def run(args: argparse.Namespace) -> int:
    """Make the settings file and return the exit code.

    Raises:
        BadInput: an answer is wrong, or no terminal can answer.
    """
    if not args.yes and not sys.stdin.isatty():
        raise BadInput("no terminal to ask at: give --yes, and --vehicle, --camera, --where as you need them")
    answers = _answers(args)
    _write(args.out, answers)
    sys.stdout.write(f"\n{args.out}: written\n")
    checked, examined = argparse.ArgumentParser(), argparse.ArgumentParser()
    config.add_arguments(checked)
    config.run(checked.parse_args(["check", str(args.out)]))
    code, there = 0, True
    if not args.no_doctor:
        doctor.add_arguments(examined)
        code = doctor.run(examined.parse_args(["--config", str(args.out)]), last=False)
        there = answers.vehicle not in ANSWERING or ANSWERING[answers.vehicle].answers(answers.link)
    _next_steps(answers, args.out, sound=code == 0, there=there)
    return code


def _answers(args: argparse.Namespace) -> Answers:
    ask = (lambda _what, _among, usual: usual) if args.yes else _ask
    vehicle, link, answered = _vehicle(args, ask)
    flies_itself = vehicle in ANSWERING
    device = "vehicle" if flies_itself else args.camera or _camera(ask)
    if device.count(".") == 3 and not device.strip("0123456789.:"):
        raise BadInput(f"--camera {device} is no camera: a stream has an address as rtsp://{device}/PATH")
    camera_file = args.camera_file or _CAMERAS.get(vehicle, _USUAL_CAMERA)
    find_file(camera_file, "cameras", args.out.parent, "--camera-file")
    pad = args.pad or USUAL_PAD
    pad_of_file(find_file(pad, "pads", args.out.parent, "--pad"))
    place = args.where or ask("place", PLACES, "indoors" if flies_itself else "outdoors")
    page = args.page or ask("page", _page_addresses(), "127.0.0.1")
    page, port = ("", Answers.port) if page == "off" else listening(page, "--page")
    channel = args.switch
    if channel is None:
        channel = _switch(link) if answered and not args.yes else 0
    return Answers(vehicle, link, device, camera_file, pad, place, page, port, channel)


def _vehicle(args: argparse.Namespace, ask: Ask) -> tuple[str, str, bool]:
    """Return the vehicle, its link or address, and whether a vehicle answers."""
    received = [] if args.link or args.vehicle in ANSWERING else found_vehicles()
    vehicle = args.vehicle or ask("vehicle", VEHICLES, received[0].name if received else _USUAL_VEHICLE)
    if args.link and vehicle not in ANSWERING:
        with refused(f"--link {args.link}", ValueError):
            options = AutopilotOptions(args.link)
        there = "" if args.no_doctor else _STACKS.get(event_loop.run(_stack_at(options)), "")
        if there and there != vehicle:
            sys.stdout.write(f"at {args.link} is {VEHICLES[there]}, not {VEHICLES[vehicle]}: docs/{there}.md is its page\n")
            vehicle = there
    usual = ANSWERING[vehicle].host if vehicle in ANSWERING else ""
    link = args.link or next((one.link for one in received if one.name == vehicle), usual)
    if not link:
        link = _USUAL_LINK
        sys.stdout.write(f"no autopilot answers: the file names {link}; --link names another\n")
    return vehicle, link, bool(received)


def _camera(ask: Ask) -> str:
    """Ask for one of the cameras of this computer."""
    names = {f"libcamera:{model}": "a Raspberry Pi's own camera" for model in libcamera_models()}
    names |= {str(one.path): one.card for one in cameras() if one.index == 0}
    names = names or {"usb": "the one USB camera, once it is plugged in"}
    return ask("camera", names, next(iter(names)))


async def _stack_at(options: AutopilotOptions) -> str:
    """Return the stack of the autopilot that sends on a link; empty if none does."""
    async with open_autopilot(options, SystemClock()) as autopilot:
        await wait_until(SystemClock(), _IDENTIFIED_S, lambda: autopilot.identity is not None)
        return "" if autopilot.identity is None else autopilot.identity.stack.value


def _switch(link: str) -> int:
    """Ask for a switch on the transmitter, show which channel moves, and return it if the user agrees; else 0."""
    wants = {"no": "", "yes": "a free one gives orders: flip it through its positions when you have answered"}
    if _ask("switch on the transmitter", wants, "no") == "no":
        return 0
    sys.stdout.write(f"flip it now ({_FLIP_S:.0f} s) ...\n")
    sys.stdout.flush()
    seen, orders = event_loop.run(seen_moving(AutopilotOptions(link), SystemClock(), _FLIP_S)), SwitchOptions()
    for channel, stood in (seen or {}).items():
        found = [f"{n} {stood[n]} us: {getattr(orders, n)}" for n in POSITIONS if n in stood]
        sys.stdout.write(f"  channel {channel}: {', '.join(found)}\n")
    if not seen:
        sys.stdout.write("no RC_CHANNELS arrives: is the receiver bound?\n" if seen is None else "no channel moved\n")
        return 0
    among = {str(channel): "" for channel in seen} | {"no": "none of them"}
    answer = _ask("channel of the switch", among, next(iter(among)))
    return 0 if answer == "no" else int(answer)


def _ask(what: str, among: dict[str, str], usual: str) -> str:
    """Ask for one of some answers on the terminal; a number, a name or Return for the usual one."""
    names = list(among)
    sys.stdout.write(f"\n{what}?\n")
    for number, name in enumerate(names, 1):
        sys.stdout.write(f"  {number:2} {name}{f'  ({among[name]})' if among[name] else ''}\n")
    while True:
        sys.stdout.write(f"[{usual}] ")
        sys.stdout.flush()
        line = sys.stdin.readline()
        if not line:
            raise BadInput(f"{what}: no answer")
        answer = line.strip() or usual
        if answer.isdecimal() and 1 <= int(answer) <= len(names):
            return names[int(answer) - 1]
        if answer in names or what == "camera":
            return answer
        sys.stdout.write(f"  a number from 1 to {len(names)}, or a name\n")


class FoundVehicle(Struct, frozen=True):
    """A vehicle that answers, and where."""

    name: str
    link: str


def found_vehicles(seconds: float = 1.5) -> list[FoundVehicle]:
    """Return the vehicles that send a HEARTBEAT to the usual ports, or answer at an address that is known."""
    with named_wait("looking for vehicles"):
        found = [*_vehicles_on_udp(seconds), *_vehicles_on_serial(seconds)]
        found += [FoundVehicle(one.word, one.host) for one in ANSWERING.values() if one.searched and one.answers(one.host)]
    for one in found:
        sys.stdout.write(f"found: {VEHICLES[one.name]} at {one.link}\n")
    return found


def _vehicles_on_udp(seconds: float) -> Iterator[FoundVehicle]:
    with selectors.DefaultSelector() as selector:
        for port in _UDP_PORTS:
            listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                listener.bind(("0.0.0.0", port))
            except OSError:  # a service or a ground station has it
                listener.close()
                continue
            selector.register(listener, selectors.EVENT_READ, (port, Codec(255, 190, datagrams=True)))
        end = time.monotonic() + seconds
        reported: set[int] = set()
        while selector.get_map() and (left := end - time.monotonic()) > 0:
            for key, _ in selector.select(left):
                port, codec = key.data
                name = _stack(codec.feed(key.fileobj.recv(2048)))  # type: ignore[union-attr]
                if name and port not in reported:
                    reported.add(port)
                    yield FoundVehicle(name, f"udpin://0.0.0.0:{port}")
        for key in list(selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]


def _vehicles_on_serial(seconds: float) -> Iterator[FoundVehicle]:
    import serial

    ports = [path for pattern in _SERIAL for path in sorted(Path("/").glob(pattern.lstrip("/")))]
    for port, speed in itertools.product(ports, _SPEEDS):
        try:
            with serial.Serial(str(port), speed, timeout=seconds) as line:
                name = _stack(Codec(255, 190).feed(line.read(2048)))
        except (OSError, serial.SerialException):
            continue
        if name:
            yield FoundVehicle(name, f"serial://{port}:{speed}")


def _stack(messages: Sequence[Message]) -> str:
    """Return the name of the autopilot that one of the messages is a HEARTBEAT of; empty if none is."""
    stacks = {mav.MAV_AUTOPILOT_ARDUPILOTMEGA: "ardupilot", mav.MAV_AUTOPILOT_PX4: "px4"}
    return next((stacks[m.autopilot] for m in messages if m.get_type() == "HEARTBEAT" and m.autopilot in stacks), "")


def _page_addresses() -> dict[str, str]:
    """Return where the page may listen: on loopback, on this computer's own address by TLS, or nowhere."""
    found = {"127.0.0.1": "this computer alone; from elsewhere through SSH"}
    if own := network_address():
        found[own] = "phones and laptops of this network, by TLS with a certificate of its own"
    return found | {"off": "no page"}


def settings_text(answers: Answers, out: Path) -> str:
    """Return the settings file, at most 40 lines, with a comment where a person has to look."""
    own = ANSWERING.get(answers.vehicle)
    autopilot = own is None
    sections = [["# Written by decklander start. Every key: docs/configuration.md, or decklander config show FILE."]]
    if own is None:
        sections.append(["[vehicle]", 'kind = "mavlink"', f'links = "{answers.link}"    # UART or UDP port of the autopilot'])
    else:
        sections.append(["[vehicle]", f'kind = "{own.kind}"', f'host = "{answers.link}"', *own.settings])
    camera = ["[camera]", f'file = "{answers.camera_file}"    # measure yours: decklander calibrate camera']
    kind, _, name = answers.camera.partition(":")
    if kind == "libcamera":
        camera += ['source = "libcamera"', f'device = "{name}"    # empty: the only one', "[camera.exposure]"]
        camera += ['mode = "pad"    # by the light on the pad, and short: motion blurs']
    elif "://" in answers.camera:
        camera += ['source = "stream"', f'device = "{answers.camera.removeprefix("stream:")}"']
    elif autopilot:
        camera += ['source = "v4l2"', f'device = "{answers.camera}"']
        if answers.place != "indoors":
            camera += ['controls = "auto_exposure=1, exposure_time_absolute=50"    # short: motion blurs', "exposure_s = 0.005"]
    sections.append(camera)
    sections.append(["[pad]", f'file = "{answers.pad}"    # print it: decklander pad print {answers.pad} --out pad.pdf'])
    colours = "simulator" if own is not None and own.simulated else "indoor" if answers.place == "indoors" else "outdoor"
    sections.append(["[vision]", f'colours = "{colours}"'])
    sections.append(["[guidance]", 'start = "signal"    # wait for an order: decklander fly begin, or the page'])
    if autopilot:
        sections.append(["[guidance.cone]", "feet_below_m = 0.1    # measure: the feet below the autopilot"])
    if answers.channel:
        sections.append(
            ["[operator.switch]", f"channel = {answers.channel}    # low: hold, middle: stay over the pad, high: land"]
        )
    fence, height_m = ("ship", 30) if answers.place == "ship" else ("start", 4 if answers.place == "indoors" else 30)
    sections.append(["[limits]", f'fence = "{fence}"', f"fence_radius_m = {max(height_m, 5)}.0", f"height_max_m = {height_m}.0"])
    sections.append(["[recorder]", "enabled = true    # every flight, in the folder recordings"])
    if answers.page:
        secure = answers.page != "127.0.0.1"
        (token, _), (key, _) = _secret("token", out), _secret("key", out)
        port = [f"port = {answers.port}"] if answers.port != 8480 else []
        page = ["[http]", *port, f'endpoint = "{"https" if secure else "http"}"', f'token_file = "{token}"']
        if secure:
            page += [f'host = "{answers.page}"', f'certificate_file = "{out.stem}.crt"', f'key_file = "{key}"']
        sections.append(page)
    return "\n".join("\n".join(lines) for lines in sections) + "\n"


def _secret(what: str, out: Path) -> tuple[str, Path]:
    """Return the word of the settings for the page's token or key, and its file: beside them, or a credential of the unit."""
    if out.resolve().parent != _UNIT_FOLDER:
        return f"{out.stem}.{what}", out.with_name(f"{out.stem}.{what}")
    name = {"token": "page", "key": "page-key"}[what]
    return f"credential:{name}", _UNIT_STORE / f"decklander.{name}"


def _write(out: Path, answers: Answers) -> None:
    """Write the settings, and the token and certificate that they name, each new and readable by its user alone."""
    (_, token), (_, key), certificate = _secret("token", out), _secret("key", out), out.with_name(out.stem + ".crt")
    with file_errors(str(out)):
        token.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if answers.page not in ("", "127.0.0.1") and not certificate.exists():
            certify(answers.page, certificate, key)
        if answers.page and not token.exists():
            write_secret(token, make_token().encode() + b"\n")
        write_whole(out, settings_text(answers, out))


def _next_steps(answers: Answers, out: Path, *, sound: bool, there: bool) -> None:
    say: Callable[[str], int] = sys.stdout.write
    command, file = "decklander" if shutil.which("decklander") else sys.argv[0], shlex.quote(str(out))
    word, token_file = _secret("token", out)
    start = "systemctl start decklander" if word.startswith("credential:") else f"{command} run --config {file}"
    own = ANSWERING.get(answers.vehicle)
    autopilot = own is None
    say("\n")
    if own is not None and not there:
        say(f"first:              {own.missing(answers.link)}\n")
    elif not sound:
        fix = f" ({command} doctor --config {file} --fix sets parameters)" if autopilot else ""
        say(f"first:              mend what is named above{fix}\n")
    say(f"pad:                {command} pad print {shlex.quote(answers.pad)} --out pad.pdf; others: {command} pad list\n")
    if autopilot:
        say(f"then:               measure feet_below_m, and the camera: {command} calibrate camera --help\n")
    say(f"start the service:  {start}\n")
    if autopilot:
        say(f"first flights:      by hand, a pad on the ground below: docs/{answers.vehicle}.md\n")
    elif sound or not there:
        say(f"fly:                {command} fly takeoff --wait 20\n")
    if not answers.page:
        return
    token = token_file.read_text(encoding="utf-8").strip()
    secure = answers.page != "127.0.0.1"
    address = f"{'https' if secure else 'http'}://{answers.page}:{answers.port}/#token={token}"
    say(f"page:               {address}\n")
    if secure and sys.stdout.isatty():
        say("\n" + qr_code(address))
