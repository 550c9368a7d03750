"""Make the options of each part from the settings. Only this module knows both."""

from __future__ import annotations

import math
from typing import Literal

from msgspec import structs

from companion.config.model import Settings
from companion.config.settings import camera_model, pad_model
from drivers.ardrone.options import ArDroneOptions
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.errors import BadInput
from estimator.options import EstimatorOptions
from estimator.vision.thesis.segmentation import COLOUR_SETS
from estimator.vision.tracker import TrackerConfig


def ardrone_options(settings: Settings) -> ArDroneOptions:
    """Return the options of the AR.Drone.

    Raises:
        BadInput: the vehicle is of another kind.
    """
    v = settings.vehicle
    if not isinstance(v, ArDroneOptions):
        raise BadInput('vehicle.kind must be "ardrone" here')
    return v


def tracker(settings: Settings) -> TrackerConfig:
    """Return the configuration of the pad tracker.

    Raises:
        BadInput: the camera or pad file is missing or has a fault.
    """
    v = settings.vision
    deck = math.radians(v.deck_tilt_sigma_deg)
    return TrackerConfig(camera_model(settings), pad_model(settings), COLOUR_SETS[v.colours], v.method, deck)


def estimator_options(settings: Settings) -> EstimatorOptions:
    """Return the estimator's options, with those that depend on the vehicle.

    An AR.Drone's optical flow is relative to the surface that it sees, deck or water; an autopilot's velocity is over the ground.
    """
    options = settings.estimator
    if options.ekf.velocity_is_over != "auto":
        return options
    over: Literal["ground", "either"] = "ground" if isinstance(settings.vehicle, AutopilotOptions) else "either"
    return structs.replace(options, ekf=structs.replace(options.ekf, velocity_is_over=over))
