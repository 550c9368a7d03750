"""An address that may hold a password, and prints itself without it.

A text of the settings in which a password was found is an `Address`: in messages, logs, reports and recordings it is masked
by itself, whoever writes it. Only who opens the address takes its `raw` text.
"""

import re

MASK = "***"
ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:(?://|\\/\\/)[^\s\"']+")
"""An address within a text."""
_USER = re.compile(r"^([^:]+:[/\\]+).*@", re.DOTALL)
_VALUE = re.compile(r"([?&;][\w.-]*(?:pass|pwd|token|key|secret|auth|user)[\w.-]*=)[^&;#]*", re.IGNORECASE)
_WHOLE = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")
_BARE = re.compile(r"(?<![\w./])[\w.%+-]+:[^\s@\"'/][^\s@\"']*@(?=[\w\[])")
"""A user and a password before a host, without what kind of address it is."""
_PROPERTY = re.compile(r"(\b[\w-]*(?:user-id|user-pw|pass|pwd|secret|token)[\w-]*\s*=\s*)(?:\"[^\"]*\"|\S+)", re.IGNORECASE)
"""A property of a GStreamer pipeline."""


def masked(text: str) -> str:
    """Return the text with the secrets of its addresses hidden: a user with password, and query values named like a secret."""
    return _BARE.sub(f"{MASK}@", ADDRESS.sub(lambda found: _hidden(found[0]), text))


def _hidden(address: str) -> str:
    return _VALUE.sub(rf"\1{MASK}", _USER.sub(rf"\1{MASK}@", address))


class Address(str):
    """A text of the settings with a password; `str`, `format` and `repr` give it without. Comparisons see all of it."""

    __slots__ = ()

    def __str__(self) -> str:
        whole = str.__str__(self)
        if _WHOLE.match(whole):
            return _hidden(whole)
        return _PROPERTY.sub(rf"\1{MASK}", masked(whole))

    def __repr__(self) -> str:
        return repr(str(self))

    def __format__(self, spec: str) -> str:
        return format(str(self), spec)


def guarded(text: str) -> str:
    """Return a text as an `Address` if a password is found in it, else as it is."""
    return address if str(address := Address(text)) != text else text


def raw(text: str) -> str:
    """Return the whole text, with the password: for who opens it, or keeps it."""
    return str.__str__(text)
