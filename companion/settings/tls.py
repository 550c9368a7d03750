"""Make the TLS contexts of the settings: the one that checks a broker, and the one of our own HTTP port."""

import ssl

from companion.settings import secret_files
from companion.settings.http import HttpSettings
from companion.settings.mqtt import MqttSettings
from companion.settings.plain_file import refuse_special
from estimator.contracts.errors import BadInput


def tls_context(settings: MqttSettings) -> ssl.SSLContext | None:
    """Return a context for TLS 1.2 or newer that checks the broker's name against its certificate, or None for plain TCP.

    Raises:
        BadInput: a file of certificates or keys that cannot be read or used.
    """
    if settings.transport != "tls":
        return None
    ca = secret_files.find(settings.ca_file, "mqtt")
    if ca is not None:
        refuse_special(ca, f"mqtt.ca_file: {ca}")
    try:
        context = ssl.create_default_context(cafile=None if ca is None else str(ca))
        context.minimum_version = ssl.TLSVersion.TLSv1_2
    except (OSError, ValueError) as why:
        raise BadInput(f"mqtt.ca_file: {ca}: {_reason(why)}") from why
    certificate, key = secret_files.find(settings.certificate_file, "mqtt"), secret_files.find(settings.key_file, "mqtt")
    if certificate is not None and key is not None:
        refuse_special(certificate, f"mqtt.certificate_file: {certificate}")
        refuse_special(key, f"mqtt.key_file: {key}")
        try:
            context.load_cert_chain(certificate, key, password=_no_passphrase)
        except (OSError, ValueError) as why:
            raise BadInput(f"mqtt.certificate_file, key_file: {certificate}, {key}: {_reason(why)}") from why
    return context


def server_context(settings: HttpSettings) -> ssl.SSLContext | None:
    """Return the TLS context of the HTTP port; None where it is served in clear.

    Raises:
        BadInput: the certificate or its key cannot be read or used.
    """
    if settings.endpoint != "https":
        return None
    certificate = secret_files.find(settings.certificate_file, "http.certificate_file")
    key = secret_files.find(settings.key_file, "http.key_file")
    assert certificate is not None
    assert key is not None
    refuse_special(certificate, f"http.certificate_file: {certificate}")
    refuse_special(key, f"http.key_file: {key}")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(certificate, key, password=_no_passphrase)
    except (OSError, ValueError) as why:  # ssl.SSLError is an OSError
        raise BadInput(f"http.certificate_file: {certificate} with http.key_file {key}: {why}") from why
    return context


def _no_passphrase() -> str:
    raise ValueError("a key with a passphrase cannot be used: nobody is there to type it")


def _reason(why: Exception) -> str:
    if isinstance(why, ssl.SSLError):
        return "not certificates or keys that fit" + (f" ({why.reason})" if why.reason else "")
    return str(getattr(why, "strerror", None) or why)
