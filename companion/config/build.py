"""From settings to the options of each part. The only place that knows both."""

from __future__ import annotations

import math
from typing import Literal

from msgspec import structs

from companion.config.model import Settings
from companion.config.settings import camera_model, pad_model
from companion.config.vehicle import ArDroneSettings, AutopilotSettings
from companion.runtime.supervise import Restart
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.samples import SampleOptions
from drivers.ardrone.velocity_loop import LoopOptions
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
    if not isinstance(v, ArDroneSettings):
        raise BadInput('vehicle.kind must be "ardrone" here')
    return ArDroneOptions(
        host=v.host,
        navdata_port=v.navdata_port,
        video_port=v.video_port,
        at_port=v.at_port,
        control_port=v.control_port,
        loop=LoopOptions(
            euler_angle_max_rad=math.radians(v.euler_angle_max_deg),
            vz_max_m_s=v.vz_max_m_s,
            yaw_rate_max_rad_s=math.radians(v.yaw_rate_max_deg_s),
            gain_1_s=v.velocity_gain_1_s,
            integral_1_s2=v.velocity_integral_1_s2,
            lead=v.velocity_lead,
        ),
        samples=SampleOptions(velocity_scale=v.velocity_scale),
        altitude_max_m=v.altitude_max_m,
        com_watchdog_s=v.com_watchdog_s,
        hold_s=v.hold_s,
        hold_com_watchdog_s=v.hold_com_watchdog_s,
        command_period_s=v.command_period_s,
        command_timeout_s=v.command_timeout_s,
        navdata_silence_s=v.navdata_silence_s,
        video_silence_s=v.video_silence_s,
        video_delay_s=v.video_delay_s,
        exposure_s=v.exposure_s,
        sample_line=settings.service.sample_queue_items,
    )


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
    over: Literal["ground", "either"] = "ground" if isinstance(settings.vehicle, AutopilotSettings) else "either"
    return structs.replace(options, ekf=structs.replace(options.ekf, velocity_is_over=over))


def restart(settings: Settings) -> Restart:
    """How a failed part comes back."""
    s = settings.service
    return Restart(s.restart_first_s, s.restart_factor, s.restart_cap_s, s.restart_healthy_after_s)
