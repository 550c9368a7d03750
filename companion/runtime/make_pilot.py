"""The pilot from the settings: pad tracker, estimator and guidance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

from msgspec import structs

from companion.config.model import Settings
from companion.config.settings import camera_model, pad_model
from companion.runtime.pilot import Pilot
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.estimates import PathName
from estimator.options import EstimatorOptions
from estimator.vision.tracker import TrackerConfig


def make_pilot(settings: Settings, shadows: Sequence[PathName] = (), kind: Callable[..., Pilot] = Pilot) -> Pilot:
    """Return the pilot that the settings describe.

    Args:
        shadows: estimator paths that run beside it to be compared.
        kind: makes the pilot in place of the class itself, from the same arguments.

    Raises:
        BadInput: the camera or pad file is missing or has a fault.
    """
    return kind(
        tracker(settings),
        estimator_options(settings),
        settings.guidance,
        automatic=settings.guidance.start == "automatic",
        shadows=shadows,
        manual=settings.operator.manual,
    )


def tracker(settings: Settings) -> TrackerConfig:
    """Return the configuration of the pad tracker.

    Raises:
        BadInput: the camera or pad file is missing or has a fault.
    """
    return TrackerConfig(camera_model(settings), pad_model(settings), settings.vision)


def estimator_options(settings: Settings) -> EstimatorOptions:
    """Return the estimator's options, with those that depend on the vehicle.

    An AR.Drone's optical flow is relative to the surface that it sees, deck or water; an autopilot's velocity is over the ground.
    """
    options = settings.estimator
    if options.ekf.velocity_is_over != "auto":
        return options
    over: Literal["ground", "either"] = "ground" if isinstance(settings.vehicle, AutopilotOptions) else "either"
    return structs.replace(options, ekf=structs.replace(options.ekf, velocity_is_over=over))
