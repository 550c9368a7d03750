"""Secrets and trust: where the password and the certificates come from, and the TLS context they make."""

from __future__ import annotations

import logging
import os
import ssl
import stat
from collections.abc import Mapping
from pathlib import Path

from companion.mqtt.settings import MqttSettings
from companion.settings_keys import CREDENTIAL
from estimator.contracts.errors import BadInput

log = logging.getLogger(__name__)

_LONGEST = 4096


def find(reference: str, environment: Mapping[str, str] = os.environ) -> Path | None:
    """The file that a setting names: a path, or `credential:NAME` in systemd's credentials directory.

    Raises:
        BadInput: a credential where systemd has given no directory, or a name with a slash.
    """
    if not reference:
        return None
    if not reference.startswith(CREDENTIAL):
        return Path(reference)
    wanted, folder = reference.removeprefix(CREDENTIAL), environment.get("CREDENTIALS_DIRECTORY")
    if not wanted or "/" in wanted or wanted in (".", ".."):
        raise BadInput(f"mqtt: {reference!r} does not name a credential")
    if not folder:
        raise BadInput(f"mqtt: {reference!r} is asked for, but there is no $CREDENTIALS_DIRECTORY (LoadCredential= in the unit)")
    return Path(folder) / wanted


def password(settings: MqttSettings) -> str | None:
    """The password, without the newline that editors leave; None where none is set.

    Raises:
        BadInput: the file cannot be read, is empty, or is not text.
    """
    path = find(settings.password_file)
    if path is None:
        return None
    try:
        if stat.S_IMODE(path.stat().st_mode) & stat.S_IROTH:
            log.warning("mqtt.password_file: %s can be read by everyone on this machine (chmod o-r)", path)
        secret = path.read_bytes()[:_LONGEST].decode().rstrip("\r\n")
    except OSError as why:
        raise BadInput(f"mqtt.password_file: {path}: {why.strerror or why}") from why
    except (UnicodeDecodeError, ValueError) as why:
        raise BadInput(f"mqtt.password_file: {path}: not text") from why
    if not secret:
        raise BadInput(f"mqtt.password_file: {path}: is empty")
    return secret


def tls_context(settings: MqttSettings) -> ssl.SSLContext | None:
    """TLS 1.2 or newer, the broker's name checked against its certificate; None for plain TCP.

    Raises:
        BadInput: a file of certificates or keys that cannot be read or used.
    """
    if settings.transport != "tls":
        return None
    ca = find(settings.ca_file)
    try:
        context = ssl.create_default_context(cafile=None if ca is None else str(ca))
        context.minimum_version = ssl.TLSVersion.TLSv1_2
    except (OSError, ValueError) as why:
        raise BadInput(f"mqtt.ca_file: {ca}: {_words(why)}") from why
    certificate, key = find(settings.certificate_file), find(settings.key_file)
    if certificate is not None and key is not None:
        try:
            context.load_cert_chain(certificate, key, password=_no_passphrase)
        except (OSError, ValueError) as why:
            raise BadInput(f"mqtt.certificate_file, key_file: {certificate}, {key}: {_words(why)}") from why
    return context


def spool_folder(settings: MqttSettings, environment: Mapping[str, str] = os.environ) -> Path | None:
    """Where events are spooled; None for in memory alone."""
    if settings.spool:
        return Path(settings.spool)
    state = environment.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(state) / "mqtt" if state else None


def _no_passphrase() -> str:
    raise ValueError("a key with a passphrase cannot be used: nobody is there to type it")


def _words(why: Exception) -> str:
    if isinstance(why, ssl.SSLError):
        return "not certificates or keys that fit" + (f" ({why.reason})" if why.reason else "")
    return str(getattr(why, "strerror", None) or why)
