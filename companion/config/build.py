"""From settings to the options of each part. The only place that knows both."""

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
    """How the drone is reached and what it is told to be.

    Raises:
        BadInput: the vehicle is another one.
    """
    v = settings.vehicle
    if not isinstance(v, ArDroneOptions):
        raise BadInput('vehicle.kind must be "ardrone" here')
    return v


def tracker(settings: Settings) -> TrackerConfig:
    """What vision needs to know.

    Raises:
        BadInput: the camera or pad file is missing or has a fault.
    """
    v = settings.vision
    deck = math.radians(v.deck_tilt_sigma_deg)
    return TrackerConfig(camera_model(settings), pad_model(settings), COLOUR_SETS[v.colours], v.method, deck)


def estimator_options(settings: Settings) -> EstimatorOptions:
    """The estimator's options with what the vehicle decides.

    An AR.Drone's optical flow is against what it sees, deck or water; an autopilot's velocity is over the ground.
    """
    options = settings.estimator
    if options.ekf.velocity_is_over != "auto":
        return options
    over: Literal["ground", "either"] = "ground" if isinstance(settings.vehicle, AutopilotOptions) else "either"
    return structs.replace(options, ekf=structs.replace(options.ekf, velocity_is_over=over))
