"""The model of the settings: one immutable struct for each table of the settings file.

Every key has its unit, its range, its meaning and, if that helps, the origin of its default. Ranges hold for values that are read
from a file (`companion.settings.load.load`); code that builds these structs itself is trusted. Defaults describe a real
AR.Drone 2.0 indoors.

In a file the keys of experts stand under `[expert]`, in the same tables as the others: `[expert.guidance.cone]` holds the keys of
`[guidance.cone]` that are not declared with `public=True`.
"""

from collections.abc import Iterator, Mapping
from functools import reduce
from inspect import get_annotations
from operator import attrgetter, getitem, or_
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin

from msgspec import Meta, Struct, defstruct

from companion.settings.capabilities import of_installed, refuse_missing, vehicle_tables
from companion.settings.guidance import GuidanceOptions
from companion.settings.links import HttpSettings, OutputOptions, VideoStreamOptions
from companion.settings.operator import LimitOptions, OperatorOptions
from companion.settings.part_table import PartTable
from companion.settings.service import RecorderOptions
from companion.settings.vessel import VesselOptions
from drivers.camera.options import DRIVEN_SOURCES, SOURCES, CameraOptions
from drivers.mavlink.options import GimbalOptions
from drivers.vehicle import VehicleOptions
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import PUBLIC, choice, text, tuning
from estimator.options import EstimatorOptions
from estimator.vision.options import TrackerOptions

_MASTS_M = 15.0
"""Height over the sea of the masts of the smallest ship with a pad: a patrol boat of 20 m."""
_Table = TypeVar("_Table", bound=Struct)
_SHIPPED_OR_PATH = "the name of a shipped one, or a path"


class CameraSettings(CameraOptions, frozen=True, forbid_unknown_fields=True):
    """The camera that looks down and the source of its frames; intrinsics, distortion and mount are in a file of their own."""

    file: Annotated[str, text(f"camera file: {_SHIPPED_OR_PATH}", 4096, public=True, page=True)]
    gimbal: GimbalOptions = GimbalOptions()


class PadSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The pad on the deck; its drawing is in a file of its own."""

    file: Annotated[str, text(f"pad file: {_SHIPPED_OR_PATH}", 4096, public=True, page=True)]


class VisionSettings(TrackerOptions, frozen=True, forbid_unknown_fields=True):
    """The processing of frames."""

    threads: Annotated[int, tuning("threads OpenCV may use for one frame", "threads", 1, 64, public=True)] = 1
    core_fraction: Annotated[
        float,
        tuning("largest fraction of a core for frames; beyond it frames are skipped; 1 skips none", "1", 0.1, 1.0, public=True),
    ] = 0.7


class ServiceSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The process: logging and health."""

    log_level: Annotated[
        Literal["debug", "info", "warning", "error"], choice("least important messages that are logged", public=True, page=True)
    ] = "info"
    health_period_s: Annotated[float, tuning("how often health is written to the log; 0 for never", "s", 0.0, 3600.0)] = 10.0


if TYPE_CHECKING:
    Vehicle = VehicleOptions
else:
    Vehicle = reduce(or_, vehicle_tables())
"""The table [vehicle]: that of any kind that is installed."""


class CommonSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The settings that every service has."""

    vehicle: Vehicle
    camera: CameraSettings
    pad: PadSettings
    vision: VisionSettings = VisionSettings()
    estimator: EstimatorOptions = EstimatorOptions()
    guidance: GuidanceOptions = GuidanceOptions()
    service: ServiceSettings = ServiceSettings()
    recorder: RecorderOptions = RecorderOptions()
    http: HttpSettings = HttpSettings()
    video_stream: VideoStreamOptions = VideoStreamOptions()
    landing_target: OutputOptions = OutputOptions()
    operator: OperatorOptions = OperatorOptions()
    limits: LimitOptions = LimitOptions()
    vessel: VesselOptions = VesselOptions()

    def faults(self) -> Iterator[str]:
        """Yield the reasons why keys do not go together on a real vehicle, each beginning with the key."""
        if self.camera.source == "vehicle" and not self.vehicle.frames_delay:
            yield f"camera.source must be one of {', '.join(SOURCES)}: an autopilot has no frames"
        for barred in self.vehicle.barred:
            if barred.is_wrong(attrgetter(barred.key)(self)):
                yield f"{barred.key} {barred.why}"
        if self.camera.exposure.driven and self.camera.source not in DRIVEN_SOURCES:
            yield (
                f'camera.exposure.mode must be "camera" with camera.source "{self.camera.source}": '
                f"only that of a camera with one of {', '.join(DRIVEN_SOURCES)} can be driven"
            )
        g = self.guidance
        least_m = max(_MASTS_M, self.vessel.pad_up_m + max(g.tries.safe_height_m, g.rendezvous.height_m))
        if g.refused == "land elsewhere" and g.elsewhere.height_m < least_m:
            yield (
                f"expert.guidance.elsewhere.height_m must be over the ship's masts, {least_m:g} m over the sea or more: "
                f"vessel.pad_up_m and guidance.rendezvous.height_m over it, and at least {_MASTS_M:g} m"
            )
        yield from filter(None, (table.fault(self) for table in self.part_tables()))

    def refuse_faults(self, where: str, before: "CommonSettings | None" = None) -> None:
        """Refuse keys that do not go together.

        Args:
            where: name of their source, for errors.
            before: settings of which these are a change. What already contradicted itself there, as in settings that a simulator
                completed and a recording keeps, is not judged by the rules of a real vehicle again.

        Raises:
            BadInput: there is such a fault.
        """
        known = () if before is None else tuple(before.faults())
        if fault := next((fault for fault in self.faults() if fault not in known), None):
            raise BadInput(f"{where}: {fault}")

    def part_tables(self) -> list[PartTable]:
        """Return the tables of the capabilities that are installed."""
        return [table for name in self.__struct_fields__ if isinstance(table := getattr(self, name), PartTable)]

    def of(self, kind: type[_Table]) -> _Table:
        """Return the table of a capability, or one of ours with its keys."""
        return next(table for name in self.__struct_fields__ if isinstance(table := getattr(self, name), kind))


if TYPE_CHECKING:
    Settings = CommonSettings
else:
    Settings = defstruct(
        "Settings",
        [(name, table, table()) for name, table in (of_installed("tables") | of_installed("extended")).items()],
        bases=(CommonSettings,),
        namespace={"__doc__": "All settings. `companion.settings.load.load` reads them from a file."},
        module=__name__,
        frozen=True,
        forbid_unknown_fields=True,
    )
"""All settings, with the tables and further keys of the installed capabilities, as `companion.settings.load.load` reads them."""


def model_with(vehicle: type[VehicleOptions]) -> type[Settings]:
    """Return the model of settings for a kind of vehicle, which another package may offer."""
    if vehicle is VehicleOptions or vehicle in vehicle_tables():
        return Settings
    found = defstruct("Settings", [("vehicle", vehicle)], bases=(Settings,), frozen=True, forbid_unknown_fields=True)
    assert issubclass(found, Settings)
    return found


EXPERT = "expert"


def joined(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a settings file with the keys below `[expert]` in the tables that they belong to.

    Args:
        data: the mapping of the file.

    Raises:
        BadInput: keys stand on the wrong side; the text names each with the table where it belongs.
    """
    inside = data.get(EXPERT, {})
    if not isinstance(inside, Mapping):
        raise BadInput(f"{EXPERT} must be a table of keys")
    outside = {name: value for name, value in data.items() if name != EXPERT}
    refuse_missing(_merged(outside, inside))
    misplaced = [f"{path} belongs in [{EXPERT}.{path.rpartition('.')[0]}]" for path, public in _known(outside) if not public]
    misplaced += [f"{EXPERT}.{path} belongs in [{path.rpartition('.')[0]}]" for path, public in _known(inside) if public]
    if misplaced:
        raise BadInput("; ".join(misplaced))
    return _merged(outside, inside)


def split(tables: Mapping[str, Any], model: type[Settings] = Settings) -> dict[str, Any]:
    """Return the tables of whole settings as a settings file has them: what `joined` joins."""
    found: dict[bool, dict[str, Any]] = {True: {}, False: {}}
    for path, public in _known(tables, (model,)):
        value: Any = reduce(getitem, path.split("."), tables)
        found[public] = _merged(found[public], _alone(path, value))
    return {**found[True], EXPERT: found[False]}


def in_file(path: str) -> str:
    """Return the dotted path of a key as a settings file has it; an unknown one stays as it is."""
    return f"{EXPERT}.{path}" if any(not public for _, public in _known(_alone(path, None))) else path


def _alone(path: str, value: object) -> dict[str, Any]:
    """Return tables that hold a single key."""
    *above, last = path.split(".")
    return reduce(lambda inner, name: {name: inner}, reversed(above), {last: value})


def _known(data: Mapping[str, Any], kinds: tuple[type[Struct], ...] = (Settings,), above: str = "") -> Iterator[tuple[str, bool]]:
    """Yield the dotted path of each key that the settings know, and whether it is public."""
    for name, value in data.items():
        if any(name == kind.__struct_config__.tag_field for kind in kinds):
            yield above + name, True
            continue
        owners = (owner for kind in kinds for owner in kind.__mro__)
        annotation = next((a for owner in owners if (a := get_annotations(owner).get(name))), None)
        if inner := _tables_of(annotation):
            if isinstance(value, Mapping):
                yield from _known(value, inner, f"{above}{name}.")
        elif annotation is not None and get_origin(annotation) is not ClassVar:
            yield above + name, any(isinstance(m, Meta) and PUBLIC in (m.extra_json_schema or {}) for m in get_args(annotation))


def _tables_of(annotation: Any) -> tuple[type[Struct], ...]:
    """Return the structs that a table of this type may be; none if it holds a single value."""
    kinds = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    return tuple(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Struct))


def _merged(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    out = dict(first)
    for name, value in second.items():
        here = out.get(name)
        out[name] = _merged(here, value) if isinstance(here, Mapping) and isinstance(value, Mapping) else value
    return out
