"""Read the certificates and keys of TLS that settings name."""

import ssl
from typing import Protocol

from companion.settings.files import find
from companion.settings.links import HttpSettings
from drivers.files import Largest, refuse_special
from estimator.contracts.errors import BadInput


def server_context(settings: HttpSettings) -> ssl.SSLContext | None:
    """Return the TLS context of the HTTP port; None where it is served in clear.

    Raises:
        BadInput: the certificate or its key cannot be read or used.
    """
    if settings.endpoint != "https":
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    add_certificate(context, settings, "http")
    return context


class Certified(Protocol):
    """A table that names a certificate and its key."""

    @property
    def certificate_file(self) -> str: ...

    @property
    def key_file(self) -> str: ...


def add_certificate(context: ssl.SSLContext, settings: Certified, section: str) -> None:
    """Load the certificate of a section and its key, if it names both.

    Raises:
        BadInput: a file cannot be read or used.
    """
    certificate, key = find(settings.certificate_file, section), find(settings.key_file, section)
    if certificate is None or key is None:
        return
    refuse_special(certificate, Largest.CERTIFICATE, f"{section}.certificate_file: {certificate}")
    refuse_special(key, Largest.CERTIFICATE, f"{section}.key_file: {key}")
    try:
        context.load_cert_chain(certificate, key, password=_no_passphrase)
    except (OSError, ValueError) as why:
        raise BadInput(f"{section}.certificate_file, key_file: {certificate}, {key}: {reason_of(why)}") from why


def _no_passphrase() -> str:
    raise ValueError("a key with a passphrase cannot be used: nobody is there to type it")


def reason_of(why: Exception) -> str:
    """Return why a file of certificates or keys cannot be used."""
    if isinstance(why, ssl.SSLError):
        return "not certificates or keys that fit" + (f" ({why.reason})" if why.reason else "")
    return str(getattr(why, "strerror", None) or why)
