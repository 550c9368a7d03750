"""The library's face: `from decklander import PadTracker, RelativeEstimator`. Reference: docs/api.md.

These are the public names of `estimator`, which is found beside this package whatever `sys.path` holds. A name is imported when
it is used first.
"""

from __future__ import annotations

from importlib import import_module

from decklander.place import claim, shipped

TYPE_CHECKING = False  # as in `estimator`
if TYPE_CHECKING:
    from estimator import (
        Attitude,
        BadInput,
        Baro,
        BodyVelocity,
        Camera,
        Detection,
        EstimatorOptions,
        Imu,
        IntegrityAlert,
        MonoNs,
        Pad,
        PadTracker,
        Range,
        RelativeEstimator,
        RelativeState,
        Rotation,
        Sighting,
        Stamp,
        Transform,
        VehicleStatus,
        Verdict,
        VesselReport,
    )

__all__ = [
    "Attitude",
    "BadInput",
    "Baro",
    "BodyVelocity",
    "Camera",
    "Detection",
    "EstimatorOptions",
    "Imu",
    "IntegrityAlert",
    "MonoNs",
    "Pad",
    "PadTracker",
    "Range",
    "RelativeEstimator",
    "RelativeState",
    "Rotation",
    "Sighting",
    "Stamp",
    "Transform",
    "VehicleStatus",
    "Verdict",
    "VesselReport",
    "shipped",
]


def __getattr__(name: str) -> object:
    """Import a public name of `estimator` when it is first used (PEP 562).

    Raises:
        AttributeError: the name is not public.
        ImportError: a foreign package `estimator` is imported already.
    """
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    claim("estimator")
    value = getattr(import_module("estimator"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
