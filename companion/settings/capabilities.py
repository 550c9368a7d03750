"""The capabilities, which can be taken off: each with what it adds, by names that are imported when they are needed.

Nothing else names a capability. Where its modules are not installed the rest works, and a settings file or a command that wants
it is refused with one line that says what to install.

A package offers another kind of vehicle as an entry point of the group `decklander.vehicles`, under the word that `vehicle.kind`
then holds: a `VehicleKind`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import reduce
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from drivers.extras import is_installed, require
from estimator.contracts.errors import BadInput, refused

if TYPE_CHECKING:  # the command line's help needs the table and no settings
    from importlib.metadata import EntryPoint

    from companion.settings.part_table import PartTable
    from drivers.vehicle import VehicleOptions

VEHICLE_GROUP = "decklander.vehicles"
Reference = tuple[str, tuple[str, ...], Callable[[], object]]
"""A settings key, the files that it names, and a function that reads them; without files one that looks for packages."""
References = Callable[[Any], Iterator[Reference]]
_NONE: Mapping[str, Any] = MappingProxyType({})


class VehicleKind(NamedTuple):
    """A kind of vehicle, as two names of the form module:object."""

    options: str
    """The table [vehicle]: a subclass of `VehicleOptions`."""
    parts: str
    """The function that makes its part of the service: a `companion.cycle.ports.MakeVehicle`."""


class Command(NamedTuple):
    """A subcommand of `decklander` (`companion.cli.commands`)."""

    group: str
    """A person's need, as `decklander --help` groups the commands."""
    module: str
    """The module that is a `companion.cli.commands.CommandModule`."""
    summary: str


class Capability(NamedTuple):
    """A part of the product that can be taken off."""

    what: str
    """Its name for a person."""
    extra: str
    """The extra of the distribution that installs what it needs."""
    module: str
    """A module that is there if it is installed."""
    needs: tuple[str, ...] = ()
    """Packages of others without which it does not work."""
    keys: tuple[str, ...] = ()
    """Keys of the settings that want it: each as its path, where it is neither empty nor off, or as path=value."""
    join: str = ""
    """The function that adds its part to the service (`companion.cycle.ports.Join`), as module:object."""
    references: str = ""
    """The function that yields the files that the settings name for it (`References`), as module:object."""
    tables: Mapping[str, str] = _NONE
    """The tables of the settings that it registers, each a `PartTable` as module:object."""
    vehicles: Mapping[str, VehicleKind] = _NONE
    """Kinds of vehicles by the word of `vehicle.kind`."""
    commands: Mapping[str, Command] = _NONE
    """Commands by the word that is typed, and actions of commands of ours by both words."""
    examine: str = ""
    """The coroutine by which `doctor` examines what the settings want of it, as module:object."""
    exporters: Mapping[str, str] = _NONE
    """Formats that `record export` writes, each by a function of a recording and a path, as module:object."""
    importers: Mapping[str, str] = _NONE
    """Readers of others' files, for `record import`, by the kind of file (`FileKind`), as module:object or module."""

    def wanted_by(self, settings: Any) -> str:
        """Return the key of the settings that wants it; empty if none does."""
        for key in self.keys:
            path, _, wanted = key.partition("=")
            value = reduce(lambda table, name: getattr(table, name, None), path.split("."), settings)
            if value == wanted if wanted else value not in (None, "", "off", False):
                return path
        return ""

    def require(self, wanted: str) -> None:
        """Refuse what is wanted where the capability is not installed.

        Raises:
            BadInput: it is not, or a package that it needs is missing; the message says what to install.
        """
        if not is_installed(self.module):
            raise BadInput(f"{wanted} needs {self.what}, which is not installed: install the extra decklander[{self.extra}]")
        require(wanted, self.extra, *self.needs)


CAPABILITIES = (
    Capability(
        "the AR.Drone",
        "ardrone",
        "drivers.ardrone",
        vehicles={"ardrone": VehicleKind("drivers.ardrone.options:ArDroneOptions", "companion.parts.ardrone.make:make_vehicle")},
    ),
    Capability(
        "the ship's wires",
        "ship",
        "companion.parts.ship",
        needs=("pynmea2", "pyais"),
        keys=("vessel.nmea", "vessel.bus", "rtk.source", "rtk.heading"),
        join="companion.parts.ship.part:join",
        references="companion.parts.ship.part:references",
        tables={"rtk": "companion.parts.ship.options:RtkOptions"},
        examine="companion.parts.ship.examine:examine",
        importers={
            "SENTENCES": "drivers.nmea.sentence_log",
            "NETWORK": "drivers.nmea.network_log",
            "MOTION": "drivers.nmea.motion",
        },
    ),
    Capability(
        "MQTT",
        "mqtt",
        "companion.parts.mqtt",
        needs=("aiomqtt", "paho"),
        keys=("mqtt.transport",),
        join="companion.parts.mqtt.part:join",
        references="companion.parts.mqtt.connection:references",
        tables={"mqtt": "companion.parts.mqtt.options:MqttSettings"},
        commands={"watch": Command("fly", "companion.cli.watch", "watch drones live in the terminal, over MQTT")},
    ),
    Capability(
        "ROS 2",
        "ros2",
        "companion.tools.ros2",
        needs=("rosbags",),
        keys=("camera.source=ros2",),
        commands={"ros2": Command("fly", "companion.cli.ros2", "publish a flight in ROS 2 while it is flown")},
        exporters={"ros2": "companion.tools.ros2.bags:export"},
        importers={"ROS_BAG": "companion.tools.ros2.bags:read"},
    ),
    Capability(
        "the gamepad",
        "gamepad",
        "companion.parts.gamepad",
        keys=("operator.gamepad",),
        join="companion.parts.gamepad.part:join",
        references="companion.parts.gamepad.mapping_file:references",
        commands={"gamepad": Command("fly", "companion.cli.gamepad", "list gamepads and show what they send")},
    ),
    Capability("Foxglove", "foxglove", "companion.parts.live", keys=("http.foxglove",), join="companion.parts.live.part:join"),
    Capability(
        "pads from pictures and printing",
        "pads",
        "companion.tools.pads",
        commands={"pad": Command("set up", "companion.cli.pad", "list, import, check or print pads")},
    ),
    Capability(
        "campaigns",
        "lab",
        "sitl.campaign",
        commands={"campaign": Command("study", "companion.cli.campaign", "fly many simulated landings and summarize them")},
    ),
    Capability(
        "the training of controllers",
        "rl",
        "study.gym",
        commands={"train": Command("study", "companion.cli.train", "train a controller in the simulated sea")},
    ),
    Capability(
        "the thesis' experiments",
        "compare",
        "study.experiments",
        commands={"experiments": Command("study", "companion.cli.experiments", "fly the thesis' experiments again")},
    ),
    Capability(
        "the import of others' files",
        "logs",
        "drivers.imports",
        commands={
            "config import": Command("set up", "companion.cli.config_import", "make a settings file of another landing program's")
        },
    ),
)
VEHICLES: Mapping[str, VehicleKind] = {
    **{word: kind for capability in CAPABILITIES for word, kind in capability.vehicles.items()},
    "mavlink": VehicleKind("drivers.mavlink.options:AutopilotOptions", "companion.parts.mavlink.make:make_vehicle"),
}


def offered(field: str, name: str, wanted: str) -> Any:
    """Return what capabilities offer under a name in one of their mappings (`exporters`, `importers`).

    Args:
        wanted: what needs it, for the error.

    Raises:
        BadInput: it is not installed.
    """
    capability = next(one for one in CAPABILITIES if name in getattr(one, field))
    capability.require(wanted)
    return imported(getattr(capability, field)[name])


def imported(name: str) -> Any:
    """Return the object that module:object names, or the module that a name alone does."""
    module, _, attribute = name.partition(":")
    return getattr(import_module(module), attribute) if attribute else import_module(module)


def part_tables() -> dict[str, type[PartTable]]:
    """Return the tables of the capabilities that are installed, by name."""
    installed = (capability for capability in CAPABILITIES if is_installed(capability.module))
    return {name: imported(table) for capability in installed for name, table in capability.tables.items()}


def refuse_missing_tables(names: Iterable[str]) -> None:
    """Refuse tables of a settings file whose capability is not installed.

    Raises:
        BadInput: one is not; the message says what to install.
    """
    for capability in CAPABILITIES:
        for name in capability.tables.keys() & set(names):
            capability.require(f"[{name}]") if not is_installed(capability.module) else None


def vehicle_tables() -> tuple[type[VehicleOptions], ...]:
    """Return the tables [vehicle] of the kinds that are installed."""
    return tuple(imported(kind.options) for kind in VEHICLES.values() if is_installed(kind.options.partition(":")[0]))


def vehicle_kind(word: str) -> VehicleKind:
    """Return the kind of vehicle of this word.

    Raises:
        BadInput: there is none, it is not installed, or the package that offers it cannot be loaded.
    """
    if (found := VEHICLES.get(word)) is not None:
        for capability in CAPABILITIES:
            if word in capability.vehicles:
                capability.require(f'vehicle.kind = "{word}"')
        return found
    offered = of_packages(VEHICLE_GROUP)
    if word not in offered:
        known = ", ".join(f'"{kind}"' for kind in sorted({*VEHICLES, *offered}))
        raise BadInput(f'vehicle.kind must be one of {known}, found "{word}"')
    kind: VehicleKind = load_offered(offered[word], f"vehicle.kind: {word!r}")
    return kind


def of_packages(group: str) -> dict[str, EntryPoint]:
    """Return what other packages offer in a group of entry points, by name."""
    from importlib.metadata import entry_points  # it takes longer to load than all settings

    return {entry.name: entry for entry in entry_points(group=group)}


def load_offered(entry: EntryPoint, wanted: str) -> Any:
    """Return what another package offers; `wanted` begins the error.

    Raises:
        BadInput: it cannot be loaded.
    """
    with refused(f"{wanted} of {entry.value} cannot be loaded", Exception):
        return entry.load()
