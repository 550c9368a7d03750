"""Hide what is secret in addresses within a settings text: the user's part of one, and query values that are named like a secret.

    text = masked('device = "rtsp://admin:hunter2@10.0.0.8/stream"')     # device = "rtsp://***@10.0.0.8/stream"
    unmasked(text, original)                                            # as it was

All other secrets are in files of their own, which settings only name.
"""

from __future__ import annotations

import re

from estimator.contracts.errors import BadInput

MASK = "***"
_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:(?://|\\/\\/)[^\s\"']+")
_USER = re.compile(r"^([^:]+:[/\\]+).*@")
_VALUE = re.compile(r"([?&;][\w.-]*(?:pass|pwd|token|key|secret|auth|user)[\w.-]*=)[^&;#]*", re.IGNORECASE)


def masked(text: str) -> str:
    """Return the text with the secrets of its addresses hidden."""
    return _ADDRESS.sub(lambda found: _masked(found[0]), text)


def unmasked(text: str, original: str) -> str:
    """Return the text with each masked address as the original has it.

    Raises:
        BadInput: a masked address is none of the original's: it was changed, so its secret would go elsewhere.
    """
    known: dict[str, set[str]] = {}
    for found in _ADDRESS.finditer(original):
        known.setdefault(_masked(found[0]), set()).add(found[0])

    def restored(found: re.Match[str]) -> str:
        address = found[0]
        if MASK not in address:
            return address
        meant = known.get(address, set())
        if len(meant) != 1:
            raise BadInput(f"{address}: the address was changed, so write its user and password anew in place of {MASK}")
        return next(iter(meant))

    return _ADDRESS.sub(restored, text)


def _masked(address: str) -> str:
    return _VALUE.sub(rf"\1{MASK}", _USER.sub(rf"\1{MASK}@", address))
