"""The capabilities, which can be taken off: each with what it adds, by names that are imported when they are needed.

Nothing else names a capability. Where its modules are not installed the rest works, and a settings file or a command that wants
it is refused with one line that says what to install.

A package offers another kind of vehicle as an entry point of the group `decklander.vehicles`, under the word that `vehicle.kind`
then holds: a `VehicleKind`. One of the group `decklander.importers` is a `drivers.importer.Importer`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import reduce
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

from drivers.extras import is_installed, require
from estimator.contracts.errors import BadInput, refused
from estimator.contracts.tables import imported

if TYPE_CHECKING:  # the command line's help needs the table and no settings
    from importlib.metadata import EntryPoint

    from drivers.importer import Importer
    from drivers.log_stamps import Tell
    from drivers.vehicle import AnsweringVehicle, VehicleOptions
    from estimator.contracts.samples import Sample
    from estimator.vision.track.config import SecondOpinion

VEHICLE_GROUP = "decklander.vehicles"
IMPORTER_GROUP = "decklander.importers"
Reference = tuple[str, tuple[str, ...], Callable[[], object]]
"""A settings key, the files that it names, and a function that reads them; without files one that looks for packages."""
References = Callable[[Any], Iterator[Reference]]
ReadOpinion: TypeAlias = "Callable[[str, str], SecondOpinion]"
"""Returns the second opinion (`estimator.vision.track.config`) that a file holds, or the shipped one for an empty name.

The second argument is the setting or option that names the file, for errors.
"""
_NONE: Mapping[str, Any] = MappingProxyType({})


class ShipLogs(Protocol):
    """A module that reads logs of a ship, beyond what is one file by itself. It raises BadInput where a log has a fault."""

    def read_sentences(self, logs: Sequence[tuple[Path, int]], tell: Tell, settings: Any) -> Iterator[Sample]:
        """Yield the samples of all logs of one ship's sentences in order; each log is moved by a time, ns."""
        ...

    def began_s(self, path: Path) -> float:
        """Return when a log of her network began by its own clock, s."""
        ...

    def ship_motion(self, sentence: str) -> tuple[float | None, ...] | None:
        """Return roll, pitch and heading, rad, and heave downward, m, of a sentence; None if a motion sensor says none in it."""
        ...


class VehicleKind(NamedTuple):
    """A kind of vehicle, as two names of the form module:object."""

    options: str
    """The table [vehicle]: a subclass of `VehicleOptions`."""
    parts: str
    """The function that makes its part of the service: a `companion.cycle.ports.MakeVehicle`."""
    flight: str = ""
    """The simulated flight of a vehicle with frames of its own (`sitl.flight.stepped.SteppedFlight`); empty for others."""
    demo: str = ""
    """The function that makes its simulated vehicle for `companion.cli.demo` (a `DemoVehicle`); empty for none."""
    answering: str = ""
    """Its vehicles whose address and camera are known, a tuple of `drivers.vehicle.AnsweringVehicle`; empty for none."""


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
    extended: Mapping[str, str] = _NONE
    """The tables of ours that it adds keys to, each by a subclass with them, as module:object; a table is extended by one."""
    vehicles: Mapping[str, VehicleKind] = _NONE
    """Kinds of vehicles by the word of `vehicle.kind`."""
    commands: Mapping[str, Command] = _NONE
    """Commands by the word that is typed, and actions of commands of ours by both words."""
    examine: str = ""
    """The coroutine by which `doctor` examines what the settings want of it, as module:object."""
    exporters: Mapping[str, str] = _NONE
    """Formats that `record export` writes, each by a function of a recording and a path, as module:object."""
    importers: Mapping[str, str] = _NONE
    """Readers of others' files, for `record import`, by the kind of file (`FileKind`): each a `drivers.importer.Read` as
    module:object."""
    ship_logs: str = ""
    """The module that reads logs of a ship: a `ShipLogs`."""
    controllers: Mapping[str, str] = _NONE
    """Controllers by the word of `guidance.controller`, each a function of a `ControllerSetup` as module:object."""
    opinions: Mapping[str, str] = _NONE
    """Second opinions of vision by the word of `vision.learned`: each a `ReadOpinion` as module:object."""
    missions: Mapping[str, str] = _NONE
    """Missions by the word of `guidance.mission`, each a function of the phases of the mission "cone" as module:object."""
    histories: Mapping[str, str] = _NONE
    """Functions that read an `AutopilotLog` for `doctor`, by the kind of file, as module:object."""

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
        keys=("bridge.links",),
        join="companion.parts.mavlink.bridge.part:join",
        references="companion.parts.mavlink.bridge.options:references",
        tables={"bridge": "companion.parts.mavlink.bridge.options:BridgeOptions"},
        vehicles={
            "ardrone": VehicleKind(
                "drivers.ardrone.options:ArDroneOptions",
                "companion.parts.ardrone.make:make_vehicle",
                flight="sitl.ardrone.flight:Flight",
                answering="companion.parts.ardrone.answering:VEHICLES",
                demo="sitl.emulators.ardrone.child:demo_vehicle",
            )
        },
        importers={"NAVDATA": "drivers.ardrone.capture:import_navdata", "PAVE": "drivers.ardrone.capture:import_video"},
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
        extended={"vessel": "companion.parts.ship.options:WiredVessel"},
        examine="companion.parts.ship.examine:examine",
        importers={"NETWORK": "companion.parts.ship.logs:import_network"},
        ship_logs="companion.parts.ship.logs",
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
        importers={"ROS_BAG": "companion.tools.ros2.bags:import_bag"},
    ),
    Capability(
        "the gamepad",
        "gamepad",
        "companion.parts.gamepad",
        keys=("operator.gamepad",),
        extended={"operator": "companion.parts.gamepad.options:GamepadOperator"},
        join="companion.parts.gamepad.part:join",
        references="companion.parts.gamepad.mapping_file:references",
        commands={"gamepad": Command("fly", "companion.cli.gamepad", "list gamepads and show what they send")},
    ),
    Capability(
        "Foxglove",
        "foxglove",
        "companion.parts.live",
        keys=("http.foxglove",),
        extended={"http": "companion.parts.live.options:LiveHttp"},
        join="companion.parts.live.part:join",
    ),
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
        "learned parts",
        "rl",
        "sitl.study.gym",
        keys=("guidance.controller=policy", "vision.learned=second_opinion"),
        references="companion.tools.second_opinion:references",
        controllers={"policy": "companion.guidance.law.policy:make_policy"},
        opinions={"second_opinion": "companion.tools.second_opinion:second_opinion"},
        commands={"train": Command("study", "companion.cli.train", "train a controller in the simulated sea")},
    ),
    Capability(
        "the thesis",
        "compare",
        "sitl.study.experiments",
        keys=(
            "guidance.mission=thesis",
            "vision.method=thesis",
            "vision.method=fused",
            "estimator.path=dead_reckoning",
            "estimator.path=constant_velocity",
        ),
        missions={"thesis": "companion.guidance.thesis:phases"},
        commands={"experiments": Command("study", "companion.cli.experiments", "fly the thesis' experiments again")},
    ),
    Capability(
        "the import of others' files",
        "logs",
        "drivers.imports",
        importers={
            "ULOG": "drivers.imports.readers:ulog",
            "DATAFLASH": "drivers.imports.readers:dataflash_log",
            "TLOG": "drivers.imports.readers:telemetry_log",
            "IMAGES": "drivers.imports.readers:images",
            "TABLE": "drivers.imports.readers:attitudes",
            "OTHER": "drivers.imports.readers:video",
        },
        histories={
            "ULOG": "drivers.imports.px4_ulog:read_history",
            "DATAFLASH": "drivers.imports.dataflash:read_history",
            "TLOG": "drivers.imports.tlog:read_history",
        },
        commands={
            "config import": Command("set up", "companion.cli.config_import", "make a settings file of another landing program's")
        },
    ),
)
VEHICLES: Mapping[str, VehicleKind] = {
    **{word: kind for capability in CAPABILITIES for word, kind in capability.vehicles.items()},
    "mavlink": VehicleKind("drivers.mavlink.options:AutopilotOptions", "companion.parts.mavlink.make:make_vehicle"),
}


def names_offered(field: str) -> list[str]:
    """Return the names in one of the mappings of the capabilities, installed or not."""
    return [name for one in CAPABILITIES for name in getattr(one, field)]


def offered(field: str, name: str, wanted: str) -> Any:
    """Return what capabilities offer under a name in one of their mappings (such as `exporters`).

    Args:
        wanted: what needs it, for the error.

    Raises:
        BadInput: it is not installed.
        StopIteration: no capability has it (`names_offered`).
    """
    capability = next(one for one in CAPABILITIES if name in getattr(one, field))
    capability.require(wanted)
    return imported(getattr(capability, field)[name])


def ship_logs(wanted: str) -> ShipLogs:
    """Return what reads logs of a ship; `wanted` needs it, for the error. Raises BadInput where it is not installed."""
    capability = next(one for one in CAPABILITIES if one.ship_logs)
    capability.require(wanted)
    reader: ShipLogs = imported(capability.ship_logs)
    return reader


def of_installed(field: str) -> dict[str, Any]:
    """Return what one of the mappings of the capabilities that are installed holds (such as `tables`), by name."""
    installed = (capability for capability in CAPABILITIES if is_installed(capability.module))
    return {name: imported(found) for capability in installed for name, found in getattr(capability, field).items()}


def refuse_missing(tables: Mapping[str, Any]) -> None:
    """Refuse tables and keys of a settings file whose capability is not installed.

    Raises:
        BadInput: one is not; the message says what to install.
    """
    for capability in (one for one in CAPABILITIES if not is_installed(one.module)):
        for name in capability.tables.keys() & tables.keys():
            capability.require(f"[{name}]")
        for key in capability.keys:
            table, _, name = key.partition(".")
            if table in capability.extended and name in (tables.get(table) or ()):
                capability.require(key)


def require_key(key: str, wanted: str) -> None:
    """Refuse what needs a key of the settings where its capability is not installed.

    Raises:
        BadInput: it is not; the message says what to install.
    """
    for capability in CAPABILITIES:
        if key in capability.keys or key.partition(".")[0] in capability.tables:
            capability.require(wanted)


def has_key(key: str) -> bool:
    """Return whether a capability that is installed adds this key to the settings."""
    return any(key in capability.keys and is_installed(capability.module) for capability in CAPABILITIES)


def installed_vehicles() -> Iterator[VehicleKind]:
    """Yield the kinds that are installed."""
    yield from (kind for kind in VEHICLES.values() if is_installed(kind.options.partition(":")[0]))


def vehicle_tables() -> tuple[type[VehicleOptions], ...]:
    """Return the tables [vehicle] of the kinds that are installed."""
    return tuple(imported(kind.options) for kind in installed_vehicles())


def answering_vehicles() -> tuple[AnsweringVehicle, ...]:
    """Return the vehicles of the kinds that are installed whose address and camera are known."""
    return tuple(one for kind in installed_vehicles() if kind.answering for one in imported(kind.answering))


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


def importer_of(path: Path) -> Importer | None:
    """Return another package's importer that recognizes a file; None if there is none.

    Raises:
        BadInput: a package's importer cannot be loaded.
    """
    for name, entry in of_packages(IMPORTER_GROUP).items():
        importer: Importer = load_offered(entry, f"the importer {name!r}")
        if importer.recognizes(path):
            return importer
    return None
