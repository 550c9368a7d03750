"""Read the files that settings name besides camera and pad: certificates, a network, the gamepad's mapping; and check them all.

`load` reads the camera and the pad. What is checked here would be read when a link is opened, which may be in flight.
"""

from __future__ import annotations

import os
import ssl
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from companion.settings import files
from companion.settings.files import CREDENTIAL
from companion.settings.links import HttpSettings, MqttSettings
from companion.settings.load import SHIPPED, find_file, read_toml
from companion.settings.model import Settings
from companion.settings.schema import explain
from drivers.ardrone.options import ArDroneOptions
from drivers.endpoint import NMEA2000, RELPOS, parse_bus, require_ship
from drivers.files import Largest, bytes_of, refuse_special
from drivers.gamepad.mapping import GamepadMapping
from drivers.mavlink.options import MavlinkOptions
from drivers.pyav import require_pyav
from drivers.ros2 import require_rosbags
from estimator.contracts.errors import BadInput

if TYPE_CHECKING:
    from estimator.vision.learned.second_opinion import SecondOpinion


def tls_context(settings: MqttSettings) -> ssl.SSLContext | None:
    """Return a context for TLS 1.2 or newer that checks the broker's name against its certificate, or None for plain TCP.

    Raises:
        BadInput: a file of certificates or keys that cannot be read or used.
    """
    if settings.transport != "tls":
        return None
    ca = files.find(settings.ca_file, "mqtt")
    if ca is not None:
        refuse_special(ca, Largest.CERTIFICATE, f"mqtt.ca_file: {ca}")
    try:
        context = ssl.create_default_context(cafile=None if ca is None else str(ca))
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        if ca is not None:  # one's own may lack extensions that Python demands from 3.13 on
            context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    except (OSError, ValueError) as why:
        raise BadInput(f"mqtt.ca_file: {ca}: {_reason(why)}") from why
    _add_certificate(context, settings, "mqtt")
    return context


def server_context(settings: HttpSettings) -> ssl.SSLContext | None:
    """Return the TLS context of the HTTP port; None where it is served in clear.

    Raises:
        BadInput: the certificate or its key cannot be read or used.
    """
    if settings.endpoint != "https":
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    _add_certificate(context, settings, "http")
    return context


def _add_certificate(context: ssl.SSLContext, settings: HttpSettings | MqttSettings, section: str) -> None:
    """Load the certificate of a section and its key, if it names both.

    Raises:
        BadInput: a file cannot be read or used.
    """
    certificate, key = files.find(settings.certificate_file, section), files.find(settings.key_file, section)
    if certificate is None or key is None:
        return
    refuse_special(certificate, Largest.CERTIFICATE, f"{section}.certificate_file: {certificate}")
    refuse_special(key, Largest.CERTIFICATE, f"{section}.key_file: {key}")
    try:
        context.load_cert_chain(certificate, key, password=_no_passphrase)
    except (OSError, ValueError) as why:
        raise BadInput(f"{section}.certificate_file, key_file: {certificate}, {key}: {_reason(why)}") from why


def _no_passphrase() -> str:
    raise ValueError("a key with a passphrase cannot be used: nobody is there to type it")


def _reason(why: Exception) -> str:
    if isinstance(why, ssl.SSLError):
        return "not certificates or keys that fit" + (f" ({why.reason})" if why.reason else "")
    return str(getattr(why, "strerror", None) or why)


SHIPPED_NETWORK = SHIPPED / "learned" / "second_opinion.onnx"


def second_opinion(file: str, what: str) -> SecondOpinion:
    """Return the network in a file; the shipped one for an empty name.

    Args:
        what: the setting or option that names the file, for errors.

    Raises:
        BadInput: the file cannot be read, is larger than 2 MB, or holds no network of this kind.
    """
    from estimator.vision.learned.second_opinion import SecondOpinion  # few look with a network

    path = Path(file) if file else SHIPPED_NETWORK
    cure = (
        f"decklander is not installed completely: install it again, or name a network with {what}"
        if not file
        else (f"name a file that is there, or leave {what} empty for the shipped network")
    )
    try:
        path.stat()
    except OSError as why:
        raise BadInput(f"{what}: {path}: {why.strerror or why}: {cure}") from why
    return SecondOpinion(bytes_of(path, Largest.NETWORK, f"{what}: {path}"), f"{what}: {path}")


def mapping_of(name_or_path: str) -> GamepadMapping:
    """Return the mapping in a file, or a shipped one (`configs/gamepads/*.toml`) by its name.

    Raises:
        BadInput: the file is missing or has a fault; the text names the file and the key.
    """
    path = find_file(name_or_path, "gamepads", Path(), "operator.gamepad")
    data = read_toml(path)
    try:
        return msgspec.convert(data, GamepadMapping, strict=True)
    except msgspec.ValidationError as why:
        raise BadInput(f"{path}: {explain(GamepadMapping, data, str(why))}") from why


def check_files(settings: Settings, environment: Mapping[str, str] = os.environ) -> tuple[str, ...]:
    """Read every key, password and certificate that the settings name, as the service does when it opens its links.

    Returns:
        The settings that name a systemd credential. Outside the systemd unit these files do not exist, so they are not read.

    Raises:
        BadInput: a file is missing, cannot be read, or does not hold what the setting needs; or a package is missing.
    """
    check_installed(settings)
    outside_unit = not environment.get("CREDENTIALS_DIRECTORY")
    unchecked = []
    for key, references, read in _references(settings):
        if outside_unit and any(reference.startswith(CREDENTIAL) for reference in references):
            unchecked.append(key)
        else:
            read()
    return tuple(unchecked)


def _require_stream(device: str) -> None:
    """Refuse the path of a video file or pipe that is not there; whether an address answers is seen when it is opened."""
    if "://" not in device and not Path(device).exists():
        raise BadInput(f"camera.device: {device}: No such file or directory")


def _references(settings: Settings) -> Iterator[tuple[str, tuple[str, ...], Callable[[], object]]]:
    """Yield (settings key, file references, function that reads the files) for everything that is switched on."""
    for section, table in (("vehicle", settings.vehicle), ("bridge", settings.bridge)):
        if isinstance(table, MavlinkOptions) and table.links and table.signing_key_file:
            what = f"{section}.signing_key_file"
            yield what, (table.signing_key_file,), partial(files.signing_key, table.signing_key_file, what)
    if settings.camera.source == "stream":
        device = settings.camera.device
        yield "camera.device", (device,), lambda: _require_stream(device)
    vision = settings.vision
    if vision.learned != "off":
        yield ("vision.learned_file", (vision.learned_file,), lambda: second_opinion(vision.learned_file, "vision.learned_file"))
    m = settings.mqtt
    if m.transport != "off":
        yield "mqtt.password_file", (m.password_file,), lambda: files.text(m.password_file, "mqtt.password_file")
        yield ("mqtt.command_key_file", (m.command_key_file,), lambda: files.key(m.command_key_file, "mqtt.command_key_file"))
        yield "mqtt.ca_file", (m.ca_file, m.certificate_file, m.key_file), lambda: tls_context(m)
    if settings.http.endpoint != "off":
        http = settings.http
        yield "http.token_file", (http.token_file,), lambda: files.token(http.token_file, "http.token_file")
        yield "http.certificate_file", (http.certificate_file, http.key_file), lambda: server_context(http)
    if settings.operator.gamepad != "off":
        yield "operator.gamepad", (settings.operator.gamepad,), lambda: mapping_of(settings.operator.gamepad)


def check_installed(settings: Settings) -> None:
    """Check that what the settings switch on can run with the packages that are installed.

    Raises:
        BadInput: a package is missing; the message names the setting and how to install it.
    """
    vehicle, camera = settings.vehicle, settings.camera
    wanting = {
        f'vehicle.model = "{getattr(vehicle, "model", "")}"': isinstance(vehicle, ArDroneOptions)
        and camera.source == "vehicle"
        and vehicle.model != "1.0",
        'camera.source = "stream"': camera.source == "stream",
        'camera.format = "H264"': camera.source == "v4l2" and camera.format == "H264",
        'recorder.frames = "h264"': settings.recorder.enabled and settings.recorder.frames == "h264",
        "video_stream.to": bool(settings.video_stream.to),
    }
    for setting, wants in wanting.items():
        if wants:
            require_pyav(setting)
    if camera.source == "ros2":
        require_rosbags('camera.source = "ros2"')
    if (bus := settings.vessel.bus) and parse_bus(bus).signalk is None:
        require_ship(f"vessel.bus {bus}", NMEA2000)
    for key in ("source", "heading"):
        if of := getattr(settings.rtk, key):
            require_ship(f"rtk.{key} {of}", RELPOS)
