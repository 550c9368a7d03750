"""Pad detection and relative navigation as a library: values in, values out. Reference: docs/api.md.

There are no sockets, files, clocks, asyncio or logging in this package. `import estimator` loads nothing else: a name's module is
imported when the name is first used.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # type checkers take it for true; importing `typing` for it would cost more than the rest of this module
if TYPE_CHECKING:
    from estimator.contracts.errors import BadInput
    from estimator.contracts.estimates import IntegrityAlert, RelativeState, Sighting, Verdict
    from estimator.contracts.geometry import Rotation, Transform
    from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VehicleStatus, VesselReport
    from estimator.contracts.time import MonoNs, Stamp
    from estimator.options import EstimatorOptions
    from estimator.pipeline import RelativeEstimator
    from estimator.vision.camera.camera import Camera
    from estimator.vision.detection import Detection
    from estimator.vision.pad.pad import Pad
    from estimator.vision.track.tracker import PadTracker

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
]

_HOMES = {
    "contracts.errors": ("BadInput",),
    "contracts.estimates": ("IntegrityAlert", "RelativeState", "Sighting", "Verdict"),
    "contracts.geometry": ("Rotation", "Transform"),
    "contracts.samples": ("Attitude", "Baro", "BodyVelocity", "Imu", "Range", "VehicleStatus", "VesselReport"),
    "contracts.time": ("MonoNs", "Stamp"),
    "options": ("EstimatorOptions",),
    "pipeline": ("RelativeEstimator",),
    "vision.camera.camera": ("Camera",),
    "vision.pad.pad": ("Pad",),
    "vision.detection": ("Detection",),
    "vision.track.tracker": ("PadTracker",),
}
_HOME_OF = {name: f"{__name__}.{home}" for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    """Import the module of a public name when the name is first used (PEP 562).

    Raises:
        AttributeError: the name is not public.
        SetupImpossible: it needs OpenCV, and there is none.
    """
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        value = getattr(import_module(_HOME_OF[name]), name)
    except ModuleNotFoundError as why:
        if why.name != "cv2":
            raise
        from estimator.contracts.errors import SetupImpossible

        raise SetupImpossible(
            f"{name} needs OpenCV 4.10 or newer (cv2), which is not installed: any of its distributions serves, "
            "as opencv-python or the extra decklander[headless]"
        ) from None
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
