"""Read the password and the certificates, and make the TLS context."""

from __future__ import annotations

import os
import ssl
from collections.abc import Mapping
from pathlib import Path

from companion.config import secret_files
from companion.mqtt.settings import MqttSettings
from estimator.contracts.errors import BadInput


def password(settings: MqttSettings) -> str | None:
    """Return the password, or None if none is set.

    Raises:
        BadInput: the file cannot be read, is empty, or is not text.
    """
    return secret_files.text(settings.password_file, "mqtt", "password_file")


def tls_context(settings: MqttSettings) -> ssl.SSLContext | None:
    """Return a context for TLS 1.2 or newer that checks the broker's name against its certificate, or None for plain TCP.

    Raises:
        BadInput: a file of certificates or keys that cannot be read or used.
    """
    if settings.transport != "tls":
        return None
    ca = secret_files.find(settings.ca_file, "mqtt")
    try:
        context = ssl.create_default_context(cafile=None if ca is None else str(ca))
        context.minimum_version = ssl.TLSVersion.TLSv1_2
    except (OSError, ValueError) as why:
        raise BadInput(f"mqtt.ca_file: {ca}: {_reason(why)}") from why
    certificate, key = secret_files.find(settings.certificate_file, "mqtt"), secret_files.find(settings.key_file, "mqtt")
    if certificate is not None and key is not None:
        try:
            context.load_cert_chain(certificate, key, password=_no_passphrase)
        except (OSError, ValueError) as why:
            raise BadInput(f"mqtt.certificate_file, key_file: {certificate}, {key}: {_reason(why)}") from why
    return context


def spool_folder(settings: MqttSettings, environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return the folder that events are spooled in, or None if they stay in memory."""
    if settings.spool:
        return Path(settings.spool)
    state = environment.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(state) / "mqtt" if state else None


def _no_passphrase() -> str:
    raise ValueError("a key with a passphrase cannot be used: nobody is there to type it")


def _reason(why: Exception) -> str:
    if isinstance(why, ssl.SSLError):
        return "not certificates or keys that fit" + (f" ({why.reason})" if why.reason else "")
    return str(getattr(why, "strerror", None) or why)
