"""Values of keys that name a file or an address."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

from msgspec import Struct, structs

CREDENTIAL = "credential:"
"""Prefix that marks the name of a systemd credential in place of a path."""
_Table = TypeVar("_Table", bound=Struct)


def anchored(table: _Table, base: Path, keys: Iterable[str]) -> _Table:
    """Return the table with the relative paths in `keys` made relative to the working directory.

    Args:
        table: a table of the settings.
        base: folder of the settings file, to which the paths are relative.
        keys: names of the keys that hold paths.
    """
    given = {key: str(getattr(table, key)) for key in keys}
    return structs.replace(
        table, **{key: str(base / path) for key, path in given.items() if path and not path.startswith(CREDENTIAL)}
    )


def on_loopback(host: str) -> bool:
    """Return whether only this machine can reach `host`. A name other than localhost may mean any address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
