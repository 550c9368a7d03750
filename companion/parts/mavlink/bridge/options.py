"""The settings of a drone that is shown to ground stations as a MAVLink vehicle: the table [bridge]."""

from collections.abc import Iterator
from functools import partial
from typing import Annotated, Any

from companion.settings.capabilities import Reference
from companion.settings.files import signing_key
from companion.settings.part_table import PartTable
from drivers.mavlink.options import MavlinkOptions
from estimator.contracts.keys import number


class BridgeOptions(MavlinkOptions, PartTable, frozen=True, forbid_unknown_fields=True):
    """An AR.Drone as a MAVLink quadrotor for ground stations, which can watch it, arm it, take off, hold and land.

    Raises:
        ValueError: as for `MavlinkOptions`.
    """

    system_id: Annotated[int, number("system id under which the drone appears", "id", 1, 255, public=True)] = 1

    @property
    def in_words(self) -> str:
        if not self.links:
            return ""
        signs = "whoever signs" if self.signing_key_file else "nobody (bridge.operators)"
        who = f"system {self.operators}" if self.operators else signs
        return f"system {self.system_id} for ground stations over {self.links} ({self.unsigned or 'signed'}), commands from {who}"

    def fault(self, settings: Any) -> str | None:
        speaks = self.links and settings.vehicle.takes_targets
        return "bridge.links must be empty: an autopilot speaks MAVLink itself" if speaks else None


def references(settings: Any) -> Iterator[Reference]:
    """Yield the key that the links are signed with."""
    file, what = settings.bridge.signing_key_file, "bridge.signing_key_file"
    if file:
        yield what, (file,), partial(signing_key, file, what)
