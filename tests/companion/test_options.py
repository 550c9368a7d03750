"""Options are the settings: a key is declared in one class, with unit, range and meaning, and TOML reaches every option."""

import dataclasses
import importlib
import inspect as python
import pkgutil
from collections.abc import Iterator
from typing import get_type_hints

import msgspec
import pytest
from msgspec import inspect

import companion
import drivers
import estimator
from companion.settings.guidance import GuidanceOptions, PidOptions
from companion.settings.mavlink import BridgeOptions, OutputOptions
from companion.settings.mission import ConeOptions, LandingLimits, ThesisOptions, TryOptions
from companion.settings.model import Settings
from companion.settings.recorder import RecorderOptions
from companion.settings.refusal import unit_of, walk
from companion.settings.restart import RestartOptions
from companion.settings.video import VideoStreamOptions
from drivers.ardrone.options import ArDroneOptions
from drivers.camera.options import CameraOptions
from drivers.mavlink.options import AutopilotOptions, SampleOptions, TimeSyncOptions
from estimator.contracts.keys import check_ranges
from estimator.ekf.options import EkfOptions
from estimator.integrity.options import IntegrityOptions
from estimator.options import DeadReckoningOptions, EstimatorOptions
from estimator.vision.options import TrackerOptions

IN_THE_FILE = {
    "vehicle": ArDroneOptions,
    "vehicle.samples": SampleOptions,
    "vehicle.timesync": TimeSyncOptions,
    "landing_target": OutputOptions,
    "bridge": BridgeOptions,
    "estimator": EstimatorOptions,
    "estimator.ekf": EkfOptions,
    "estimator.dead_reckoning": DeadReckoningOptions,
    "estimator.integrity": IntegrityOptions,
    "guidance": GuidanceOptions,
    "guidance.pid": PidOptions,
    "guidance.cone": ConeOptions,
    "guidance.limits": LandingLimits,
    "guidance.tries": TryOptions,
    "guidance.thesis": ThesisOptions,
    "camera": CameraOptions,
    "recorder": RecorderOptions,
    "vision": TrackerOptions,
    "service": RestartOptions,
    "video_stream": VideoStreamOptions,
}


TABLES = {
    "companion.guidance": ("guidance", "guidance.pid", "guidance.cone", "guidance.limits", "guidance.tries", "guidance.thesis"),
    "companion.parts.mavlink": ("vehicle", "landing_target", "bridge"),
    "companion.parts.live": ("foxglove",),
    "companion.parts.metrics": ("metrics",),
    "companion.parts.mqtt": ("mqtt",),
    "companion.recording": ("recorder",),
    "companion.parts.recorder": ("recorder",),
    "companion.base": ("service",),
    "companion.service": ("service",),
    "companion.parts.video": ("video_stream",),
    "drivers.ardrone": ("vehicle",),
    "drivers.camera": ("camera",),
    "drivers.mavlink": ("vehicle", "vehicle.samples", "vehicle.timesync", "bridge", "camera.gimbal"),
    "estimator.vision": ("vision",),
    "estimator": ("estimator", "estimator.ekf", "estimator.dead_reckoning", "estimator.integrity"),
}
"""The tables that hold what the classes of a package take."""


def classes() -> Iterator[type]:
    """Yield every options class of the packages that fly."""
    for package in (companion, drivers, estimator):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if found.name.startswith("companion.cli") or found.name.endswith("__main__"):
                continue
            module = importlib.import_module(found.name)
            for name, kind in vars(module).items():
                if python.isclass(kind) and kind.__module__ == found.name and name.endswith(("Options", "Timeouts")):
                    yield kind


def test_no_option_is_declared_a_second_time() -> None:
    keys = {path for path, _ in walk(Settings)}
    twice = {
        (kind.__name__, field.name)
        for kind in classes()
        if dataclasses.is_dataclass(kind)
        for package, tables in TABLES.items()
        if kind.__module__.startswith(package)
        for field in dataclasses.fields(kind)
        if field.default is not dataclasses.MISSING and any(f"{table}.{field.name}" in keys for table in tables)
    }
    assert twice == set()


def test_no_class_repeats_the_default_of_another() -> None:
    """A struct declares a key itself or inherits it, and a key that is declared again says the same except for being required."""
    for kind in classes():
        if not issubclass(kind, msgspec.Struct):
            continue
        own = set(vars(kind).get("__annotations__", {}))
        for base in kind.__mro__[1:]:
            again = own & set(vars(base).get("__annotations__", {}))
            assert all(field.required for field in msgspec.structs.fields(kind) if field.name in again), (kind, again)


def test_the_vehicle_is_either_driver_s_options() -> None:
    assert get_type_hints(Settings)["vehicle"] == ArDroneOptions | AutopilotOptions


@pytest.mark.parametrize("table", sorted(IN_THE_FILE))
def test_every_option_of_the_class_is_a_key_of_its_table(table: str) -> None:
    kind = IN_THE_FILE[table]
    assert issubclass(kind, msgspec.Struct)
    keys = {path for path, _ in walk(Settings)}
    for name, value in ((name, getattr(kind(), name)) for name in kind.__struct_fields__):
        path = f"{table}.{name}"
        assert any(key.startswith(f"{path}.") for key in keys) if isinstance(value, msgspec.Struct) else path in keys, path


def test_every_key_has_unit_range_and_meaning() -> None:
    for path, field in walk(Settings):
        assert isinstance(field.type, inspect.Metadata), path
        assert (field.type.extra_json_schema or {})["description"], path
        bare = field.type.type
        if isinstance(bare, inspect.FloatType | inspect.IntType):
            assert unit_of(field.type), path
            assert bare.ge is not None, path
            assert bare.le is not None, path
            if not field.required:
                assert bare.ge <= field.default <= bare.le, path


def test_a_number_out_of_range_is_refused_in_code_as_in_a_file() -> None:
    with pytest.raises(ValueError, match=r"EkfOptions\.forget_s must lie in 0.1 to 600, got nan"):
        EkfOptions(forget_s=float("nan"))
    with pytest.raises(ValueError, match=r"EkfOptions\.velocity_is_over must be one of"):
        EkfOptions(velocity_is_over="water")  # type: ignore[arg-type]
    check_ranges(EkfOptions())
