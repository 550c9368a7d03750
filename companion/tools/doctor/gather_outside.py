"""Take a snapshot from outside the service, and of an autopilot from its flight log. It judges nothing.

Of the service: its files, camera, broker, drone and ship, and its figures if it is running.
"""

import asyncio
import contextlib
import difflib
import re
import ssl
import sys
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path

import aiohttp
from msgspec import structs
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.samples import Sample

from companion.settings import files
from companion.settings.capabilities import CAPABILITIES, names_offered, offered
from companion.settings.links import HttpSettings
from companion.settings.model import Settings
from companion.tools.doctor.diagnose import PARAMETERS
from companion.tools.doctor.firmware_parameters import RENAMED, differing, names_in
from companion.tools.doctor.gather_service import figures, files_of, servers_of
from companion.tools.doctor.snapshot import AutopilotSnapshot, ServiceSnapshot, Snapshot
from drivers.camera.open_camera import open_camera
from drivers.file_kinds import DECRYPT, FileKind, kind_of
from drivers.files import Largest, bytes_of
from drivers.log_history import AutopilotLog, LogHistory
from drivers.log_stamps import Tell
from estimator.contracts.errors import BadInput, DecklanderError
from estimator.contracts.tables import imported
from estimator.contracts.text import utf8_of
from estimator.contracts.time import Clock, seconds_between

_MANY = 100
"""A log with this many parameters holds all of them: one that is missing is not in the firmware."""
_COPTER = "ArduCopter"
_SYSTEM = ("SYSID_THISMAV", "MAV_SYSID", "MAV_SYS_ID")
_ALIKE = 0.8
"""Least likeness of a misspelt word: none of 1,700 real files of ArduCopter's parameters has a name that is taken for another."""
_NEAR_DECK_S = 10.0
"""Time before a landing in which targets may end: the pad leaves the picture, and none are sent on the ground."""
_LARGEST = 3.4e38
"""An autopilot keeps 32 bits of a value."""
_FIRST_FRAME_S = 5.0
"""Longest time until a camera's first frame, seconds."""


def examine_log(path: Path) -> Snapshot:
    """Return the snapshot of a flight log, a telemetry log or a file of parameters, distinguished by their content.

    Raises:
        BadInput: the file cannot be read, is none of them, or is of a vehicle that cannot hover.
    """
    kind, notes = kind_of(path), list[str]()
    if kind is FileKind.PARAMETERS:
        snapshot = _log_snapshot(path, file := parameters_of(path))
        a = snapshot.autopilot
        assert a is not None
        unjudged = tuple(sorted(file.parameters.keys() - a.parameters.keys() - a.misspelt.keys() - set(_SYSTEM)))
        return structs.replace(snapshot, log=None, autopilot=structs.replace(a, unread=file.history.notes, unjudged=unjudged))
    if kind is FileKind.ENCRYPTED:
        raise BadInput(f"{path}: {kind.value}: {DECRYPT}")
    if kind.name not in names_offered("histories"):
        raise BadInput(
            f"{path}: {kind.value}, and neither a dataflash log (.bin, .log), a PX4 log (.ulg), a telemetry log (.tlog) nor a "
            "file of parameters"
        )
    read: Callable[[Path, Tell], AutopilotLog] = offered("histories", kind.name, f"{path}: {kind.value}")
    with contextlib.redirect_stdout(sys.stderr):  # parsers print what they meet, and standard output is for findings
        log = read(path, notes.append)
    return _log_snapshot(path, structs.replace(log, history=structs.replace(log.history, notes=tuple(notes))))


def _log_snapshot(path: Path, log: AutopilotLog) -> Snapshot:
    if log.vehicle not in (None, _COPTER):
        raise BadInput(f"{path}: it is a log of {log.vehicle}, and no rule knows that vehicle")
    asked = names_in(PARAMETERS[log.stack], log.firmware, log.parameters)
    system = next((int(log.parameters[n]) for n in _SYSTEM if n in log.parameters), 1)
    return Snapshot(
        0.0,
        autopilot=AutopilotSnapshot(
            stack="ArduPilot" if log.stack == "ArduPilot" else "PX4",
            system=system,
            firmware=log.firmware,
            mode="auto.precland" if log.precision_landing else "unknown",
            parameters={n: v for n, v in log.parameters.items() if n in asked},
            absent=tuple(n for n in asked if n not in log.parameters) if len(log.parameters) >= _MANY else (),
            misspelt=_misspelt(log.parameters, log.stack),
            texts=_standing(log),
            events=log.events,
            differs=differing(log.parameters, log.defaults),
        ),
        log=log.history,
    )


def _misspelt(read: Mapping[str, float], stack: str) -> dict[str, str]:
    """Return the names that are those of known parameters, which are missing, but for letters of one long word."""
    names = dict.fromkeys((*PARAMETERS[stack], *(RENAMED[name].name for name in PARAMETERS[stack] if name in RENAMED)))
    known = [name for name in names if name not in read]
    out = {}
    for name in read.keys() - names:
        for k, word in enumerate(words := name.split("_")):
            like = re.compile("_".join((*words[:k], "([A-Z]{3,})", *words[k + 1 :])))
            there = [found[1] for one in known if (found := like.fullmatch(one)) is not None]
            for near in difflib.get_close_matches(word, there, 1, _ALIKE) if re.fullmatch("[A-Z]{3,}", word) else ():
                out[name] = "_".join((*words[:k], near, *words[k + 1 :]))
    return dict(sorted(out.items()))


def _standing(log: AutopilotLog) -> tuple[str, ...]:
    """Return the texts of a log but those of ArduPilot's precision landing that a later one takes back.

    Its estimate is begun by the first target, whether or not somebody ordered a landing. What came well before the contact is
    no fault of the landing, and a target that is lost just before a landing, or after it, is none at all.
    """
    out, begun = [], False
    for text, at_s in reversed(tuple(zip(log.texts, log.text_times_s, strict=True))):
        lower = text.lower()
        begun |= "precland: init complete" in lower
        landed = any(at_s >= one.at_s - _NEAR_DECK_S for one in log.history.landings)
        if ("precland: init failed" in lower and begun) or ("precland: target lost" in lower and (begun or landed)):
            continue
        out.append(text)
    return tuple(reversed(out))


_PX4_NAMES = re.compile(r"MAV_SYS_ID|(COM|MPC|EKF2|CAL|SENS|NAV|LNDMC|RTL|CBRK|MC|IMU)_")
_OF_TABLE = re.compile(r"(\d+)\t(\d+)\t")
_DECIMAL_COMMA = re.compile(r"(?:\d+\s+\d+\s+)?[A-Z]\w*[\s,;=]+\"?-?\d*,\d+(?:[eE][-+]?\d+)?\"?\s*(?:[\t;]\s*\d+\s*)?(?:#|$)")
_TWO_VALUES = re.compile(r"\w+,\s*Value\b")
"""The head of a table that has another column of numbers behind the value."""
_ARDUPILOT_NAMES = re.compile(r"SYSID_|MAV_SYSID|FRAME_CLASS|(INS|EK3|ATC|PSC|PLND|GUID|LAND|WPNAV|ARMING|SERVO\d+|RC\d+)_")


def parameters_of(path: Path) -> AutopilotLog:
    """Read a file of parameters as ground stations keep them: `NAME,VALUE`, `NAME;VALUE`, `NAME VALUE`, or QGroundControl's tabs.

    Return a log that holds nothing else but, as its notes, the lines that are not or not wholly taken; the stack is given by the
    file, or by its names.

    Raises:
        BadInput: the file cannot be read, no line of it is a parameter, or a value is not clear: two of one name, two vehicles,
            decimal commas, a file that is included.
    """
    lines = utf8_of(bytes_of(path, Largest.TABLE)).decode("utf-8", "replace").splitlines()
    parameters, notes = dict[str, float](), list[str]()
    table = [row for line in lines if (row := _OF_TABLE.match(line)) is not None]
    if len({row[1] for row in table}) > 1:
        raise BadInput(f"{path}: it holds the parameters of several vehicles: save those of one")
    usual = Counter(row[2] for row in table).most_common(1)
    two_values = any(map(_TWO_VALUES.match, lines))
    for number, line in enumerate(lines, 1):
        if not two_values and _DECIMAL_COMMA.match(line):
            raise BadInput(f"{path}: decimal commas, or two values: {line.strip()[:60]!r}: save it with points")
        if line.startswith("@include"):
            raise BadInput(f"{path}: it includes another file ({line[8:].strip()}): give one with all parameters")
        if table and (row := _OF_TABLE.match(line)) is not None and row[2] != usual[0][0]:
            notes.append(f"line {number}: of component {row[2]}, such as a gimbal")
            continue
        if (found := _parameter_in(line)) is not None:
            name, value, further = found
            if value is None:
                raise BadInput(f"{path}: {name} has no number as its value (of 32 bits): {line.strip()[:60]!r}")
            if parameters.setdefault(name, value) != value:
                raise BadInput(f"{path}: {name} stands in it twice, as {parameters[name]:g} and as {value:g}")
            if further and not two_values:
                notes.append(f"line {number}: {line.strip()[:60]!r}: read is {name} {value:g}")
        elif line.split("#")[0].strip() and not _TWO_VALUES.match(line):
            notes.append(f"line {number}: {line.strip()[:60]!r}: no parameter")
    if not parameters:
        raise BadInput(f"{path}: no line of it is a parameter")
    comments = " ".join(line for line in lines[:40] if line.startswith("#"))
    output = re.search(r"Stack:\s*(PX4|ArduPilot)", comments)
    px4 = sum(_PX4_NAMES.match(name) is not None for name in parameters)
    ardupilot = sum(_ARDUPILOT_NAMES.match(name) is not None for name in parameters)
    stack = output[1] if output is not None else "PX4" if px4 > ardupilot else "ArduPilot"
    version = re.search(r"Version:\s*(\d+)\.(\d+)\.(\d+)", comments)
    firmware = None if version is None else (int(version[1]), int(version[2]), int(version[3]))
    return AutopilotLog(stack, None, firmware, dict(sorted(parameters.items())), (), (), LogHistory(0.0, notes=tuple(notes)))


def _parameter_in(line: str) -> tuple[str, float | None, bool] | None:
    """Return a line's name, its value (None if that is no number) and whether words follow; None if it is no parameter's."""
    words = re.split(r"[\s,;=]+", line.split("#")[0].strip())
    if len(words) >= 4 and words[0].isdigit() and words[1].isdigit():
        words = words[2:4]
    if len(words) < 2 or re.fullmatch(r"[A-Z][A-Z0-9_]{0,15}", words[0]) is None:
        return None
    try:
        value = float(words[1])
    except ValueError:
        ours = len(words) <= 3 and (_ARDUPILOT_NAMES.match(words[0]) or _PX4_NAMES.match(words[0]))
        return (words[0], None, False) if ours else None
    return words[0], value if abs(value) <= _LARGEST else None, len(words) > 2


Examine = Callable[[ServiceSnapshot, Settings, Clock, float], Awaitable[ServiceSnapshot]]
"""Examines what a capability reads, for some seconds, and returns the snapshot with what was found."""


async def examine_service(
    settings: Settings | None, broker: str | None, clock: Clock, seconds: float = 2.0, timeout_s: float = 2.0
) -> ServiceSnapshot:
    """Check files, broker and drone; read the metrics of a running service, or else count the camera's frames.

    Args:
        broker: HOST:PORT of the broker to check; None for the one in the settings.
        seconds: how long to count the camera's frames.
    """
    snapshot = ServiceSnapshot()
    if settings is not None:
        snapshot = await _from_settings(settings, clock, seconds, timeout_s)
        servers = [f"{host}:{port}" for host, port in servers_of(settings)]
        broker = broker or next(iter(servers), None)
    if broker is None:
        return snapshot
    host, _, port = broker.rpartition(":")
    fault = await _unreachable(host or broker, int(port) if host else 1883, timeout_s)
    return structs.replace(snapshot, broker=broker, broker_fault=fault)


async def _from_settings(settings: Settings, clock: Clock, seconds: float, timeout_s: float) -> ServiceSnapshot:
    snapshot = files_of(settings)
    if snapshot.camera_fault is not None:
        return snapshot
    if (probe := settings.vehicle.probe) is not None:
        host, port = probe
        snapshot = structs.replace(snapshot, drone=f"{host}:{port}", drone_fault=await _unreachable(host, port, timeout_s))
    scraped = await _scrape(settings, timeout_s)
    if scraped is not None:
        return _of_metrics(snapshot, settings, scraped)
    for capability in CAPABILITIES:
        if capability.examine and (wanted := capability.wanted_by(settings)):
            capability.require(wanted)
            examine: Examine = imported(capability.examine)
            snapshot = await examine(snapshot, settings, clock, seconds)
    return await _of_camera(snapshot, settings, clock, seconds)


async def _of_camera(snapshot: ServiceSnapshot, settings: Settings, clock: Clock, seconds: float) -> ServiceSnapshot:
    try:
        if settings.camera.source == "vehicle":
            return snapshot
        async with open_camera(settings.camera, snapshot.camera_size, clock) as camera:
            try:
                async with asyncio.timeout(_FIRST_FRAME_S):
                    frame = await camera.frames.get()
            except TimeoutError:
                return structs.replace(snapshot, device_fault=camera.down or camera.damage or "it sends no frame")
            height, width = frame.px.shape[:2]
            began, before = clock.now(), camera.counters.frames
            await clock.sleep(seconds)
            rate_hz = (camera.counters.frames - before) / seconds_between(began, clock.now())
    except DecklanderError as why:
        return structs.replace(snapshot, device_fault=str(why))
    return structs.replace(snapshot, device_fault=camera.damage, frame_size=(width, height), frame_rate_hz=rate_hz)


async def _scrape(settings: Settings, timeout_s: float) -> list[Sample] | None:
    """Return the metrics of the running service; None if nothing answers."""
    http = settings.http
    if http.endpoint == "off":
        return None
    host = "127.0.0.1" if http.host in ("0.0.0.0", "::") else http.host
    try:
        token = files.text(http.token_file, "http.token_file")
    except BadInput:  # a finding of its own, or a credential that only the unit has
        return None
    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    try:
        async with (
            aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(timeout_s)) as session,
            session.get(f"{http.endpoint}://{host}:{http.port}/metrics", headers=headers, ssl=_our_own(http)) as answer,
        ):
            answer.raise_for_status()
            page = await answer.text()
        return [sample for family in text_string_to_metric_families(page) for sample in family.samples]
    except (OSError, TimeoutError, aiohttp.ClientError, ValueError):
        return None


def _our_own(http: HttpSettings) -> ssl.SSLContext | bool:
    """Return how to check that our own service answers: it has the certificate of the settings, whatever name that is for."""
    if http.endpoint == "http":
        return True
    certificate = files.find(http.certificate_file, "http.certificate_file")
    context = ssl.create_default_context(cafile=certificate)
    context.check_hostname = False
    context.verify_flags = context.verify_flags & ~ssl.VERIFY_X509_STRICT | ssl.VERIFY_X509_PARTIAL_CHAIN
    return context


def _of_metrics(snapshot: ServiceSnapshot, settings: Settings, scraped: list[Sample]) -> ServiceSnapshot:
    counts: dict[str, dict[str, float]] = {}
    for s in scraped:
        if s.name == "decklander_count":
            counts.setdefault(s.labels["part"], {})[s.labels["name"]] = s.value
    rates_hz = {s.labels["kind"]: s.value for s in scraped if s.name == "decklander_item_rate_hertz"}
    medians_s = {
        s.labels["stage"]: s.value for s in scraped if s.name == "decklander_stage_seconds" and s.labels["quantile"] == "0.5"
    }
    return figures(snapshot, settings, counts, rates_hz, medians_s)


async def _unreachable(host: str, port: int, timeout_s: float) -> str | None:
    """Return why a TCP connection fails; None if it succeeds."""
    try:
        async with asyncio.timeout(timeout_s):
            _, writer = await asyncio.open_connection(host, port)
    except TimeoutError:
        return f"no answer within {timeout_s:g} s"
    except OSError as why:
        return why.strerror or str(why)
    writer.close()
    return None
