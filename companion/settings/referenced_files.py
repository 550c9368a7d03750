"""Read the files that settings name besides camera and pad: certificates, keys, and those of capabilities; and check them all.

`load` reads the camera and the pad. What is checked here would be read when a link is opened, which may be in flight.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

from companion.settings import files
from companion.settings.capabilities import CAPABILITIES, Reference, References
from companion.settings.certificates import server_context
from companion.settings.files import CREDENTIAL
from companion.settings.model import Settings
from drivers.mavlink.options import autopilot_of
from drivers.pyav import require_pyav
from estimator.contracts.errors import BadInput
from estimator.contracts.tables import imported


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


def _references(settings: Settings) -> Iterator[Reference]:
    """Yield (settings key, file references, function that reads the files) for everything that is switched on."""
    autopilot, what = autopilot_of(settings.vehicle), "vehicle.signing_key_file"
    if autopilot is not None and autopilot.links and autopilot.signing_key_file:
        yield what, (autopilot.signing_key_file,), partial(files.signing_key, autopilot.signing_key_file, what)
    if settings.camera.source == "stream":
        device = settings.camera.device
        yield "camera.device", (device,), lambda: _require_stream(device)
    if settings.http.endpoint != "off":
        http = settings.http
        yield "http.token_file", (http.token_file,), lambda: files.token(http.token_file, "http.token_file")
        yield "http.certificate_file", (http.certificate_file, http.key_file), lambda: server_context(http)
    yield from _of_capabilities(settings)


def _of_capabilities(settings: Settings) -> Iterator[Reference]:
    for capability in CAPABILITIES:
        if capability.references and capability.wanted_by(settings):
            named: References = imported(capability.references)
            yield from named(settings)


def check_installed(settings: Settings) -> None:
    """Check that what the settings switch on can run with the packages that are installed.

    Raises:
        BadInput: a package is missing; the message names the setting and how to install it.
    """
    vehicle, camera = settings.vehicle, settings.camera
    wanting = {
        vehicle.decoder_for: camera.source == "vehicle" and bool(vehicle.decoder_for),
        'camera.source = "stream"': camera.source == "stream",
        'camera.format = "H264"': camera.source == "v4l2" and camera.format == "H264",
        'recorder.frames = "h264"': settings.recorder.enabled and settings.recorder.frames == "h264",
        "video_stream.to": bool(settings.video_stream.to),
    }
    for setting, wants in wanting.items():
        if wants:
            require_pyav(setting)
    for capability in CAPABILITIES:
        if key := capability.wanted_by(settings):
            capability.require(key)
    for _, named, look in _of_capabilities(settings):
        if not named:
            look()
