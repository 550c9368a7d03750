"""Check the files that settings name besides camera and pad: keys, passwords, certificates, the gamepad's mapping, a network.

`load` reads the camera and the pad. What is checked here would be read when a link is opened, which may be in flight.
"""

import os
from collections.abc import Callable, Iterator, Mapping

from companion.settings import secret_files
from companion.settings.model import Settings
from companion.settings.secret_files import CREDENTIAL
from drivers.ardrone.options import ArDroneOptions
from drivers.mavlink.options import AutopilotOptions
from drivers.pyav import require_pyav
from estimator.contracts.errors import BadInput


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


def _references(settings: Settings) -> Iterator[tuple[str, tuple[str, ...], Callable[[], object]]]:
    """Yield (settings key, file references, function that reads the files) for everything that is switched on."""
    if isinstance(settings.vehicle, AutopilotOptions) and settings.vehicle.signing_key_file:
        yield _signing("vehicle", settings.vehicle.signing_key_file)
    if settings.bridge.links and settings.bridge.signing_key_file:
        yield _signing("bridge", settings.bridge.signing_key_file)
    vision = settings.vision
    if vision.learned != "off":
        from companion.settings.learned_file import second_opinion

        yield (
            "vision.learned_file",
            (vision.learned_file,),
            lambda: second_opinion(vision.learned_file, "vision.learned_file"),
        )
    m = settings.mqtt
    if m.transport != "off":
        from companion.settings.tls import tls_context

        yield "mqtt.password_file", (m.password_file,), lambda: secret_files.text(m.password_file, "mqtt", "password_file")
        yield (
            "mqtt.command_key_file",
            (m.command_key_file,),
            lambda: secret_files.key(m.command_key_file, "mqtt", "command_key_file"),
        )
        yield "mqtt.ca_file", (m.ca_file, m.certificate_file, m.key_file), lambda: tls_context(m)
    if settings.http.endpoint != "off":
        from companion.settings.tls import server_context

        http = settings.http
        yield "http.token_file", (http.token_file,), lambda: secret_files.token(http.token_file, "http", "token_file")
        yield "http.certificate_file", (http.certificate_file, http.key_file), lambda: server_context(http)
    if settings.operator.gamepad != "off":
        from companion.settings.gamepad import mapping_of

        yield "operator.gamepad", (settings.operator.gamepad,), lambda: mapping_of(settings.operator.gamepad)


def _signing(section: str, reference: str) -> tuple[str, tuple[str, ...], Callable[[], object]]:
    from drivers.mavlink.signing import load_key

    def read() -> None:
        try:
            load_key(reference)
        except BadInput as why:
            raise BadInput(f"{section}.signing_key_file: {why}") from why

    return f"{section}.signing_key_file", (reference,), read


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
