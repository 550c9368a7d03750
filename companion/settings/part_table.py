"""The port of a capability's own table of the settings."""

from typing import Any

from msgspec import Struct

from drivers.vehicle import Claim


class PartTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The facts that a capability's table gives to all that names no capability."""

    @property
    def orders_recordings(self) -> bool:
        """True if a recording may be switched by what it describes."""
        return False

    @property
    def server(self) -> tuple[str, int] | None:
        """Host and TCP port of the server that it connects to; None without one."""
        return None

    @property
    def in_words(self) -> str:
        """A line for a person who checks the settings; empty for none."""
        return ""

    def fault(self, settings: Any) -> str | None:
        """Return the reason why settings do not go with it, or None if they do."""
        return None

    def claims(self) -> list[Claim]:
        """Return what a service of this computer has for itself by it."""
        return []
