"""What a person can set: one immutable struct a table of the settings file.

Every key says its unit, its range, what it means and, where that helps, where its default comes from. Ranges hold for
what is read from a file (`companion.config.settings.load`); code that builds these structs itself is trusted. Defaults describe
a real AR.Drone 2.0 indoors.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Struct

from companion.config.camera import CameraSettings as CameraSettings
from companion.config.recorder import RecorderSettings
from companion.config.vehicle import ArDroneSettings, AutopilotSettings, BridgeSettings
from companion.guidance.pid import Gains
from companion.guidance.plan import Plan
from companion.metrics.settings import MetricsSettings
from companion.mqtt.settings import MqttSettings
from estimator.contracts.keys import choice, number, text
from estimator.options import EstimatorOptions

_TUNED = "tuned in simulation"
_SHIPPED_OR_PATH = "the name of a shipped one, or a path relative to the settings file"


class PadSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Which pad is on the deck: its drawing is in a file of its own."""

    file: Annotated[str, text(f"pad file: {_SHIPPED_OR_PATH}", 4096)]


class VisionSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """How frames are looked at."""

    method: Annotated[
        Literal["fused", "registration", "thesis"],
        choice("what a frame says: all methods together; the aligned drawing alone; the thesis' three, chosen by priority"),
    ] = "fused"
    colours: Annotated[
        Literal["simulator", "indoor", "outdoor"],
        choice("which set of colour limits the thesis' methods segment the pad with", "thesis table 4.1"),
    ] = "indoor"
    deck_tilt_sigma_deg: Annotated[
        float, number("one standard deviation of the deck's roll and pitch", "deg", 0.0, 30.0, "supply vessel in a slight sea")
    ] = 2.0
    threads: Annotated[int, number("threads OpenCV may use for one frame", "threads", 1, 64)] = 1


_GAINS = Gains()
_PLAN = Plan.over_the_pad()
_Kp = Annotated[float, number("proportional gain", "1/s", 0.0, 20.0, _TUNED)]
_Ki = Annotated[float, number("integral gain", "1/s^2", 0.0, 10.0, _TUNED)]
_Kd = Annotated[float, number("derivative gain", "1", 0.0, 10.0, _TUNED)]


class HorizontalGainsSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """From metres of error forward and right to m/s."""

    kp: _Kp = _GAINS.horizontal.kp
    ki: _Ki = _GAINS.horizontal.ki
    kd: _Kd = _GAINS.horizontal.kd


class VerticalGainsSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """From metres of error in height to m/s."""

    kp: _Kp = _GAINS.vertical.kp
    ki: _Ki = _GAINS.vertical.ki
    kd: _Kd = _GAINS.vertical.kd


class HeadingGainsSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """From radians of error in heading to rad/s."""

    kp: _Kp = _GAINS.heading.kp
    ki: _Ki = _GAINS.heading.ki
    kd: _Kd = _GAINS.heading.kd


class PidSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The position controller: limits of what it asks for, and where it is soft."""

    speed_max_m_s: Annotated[float, number("largest horizontal velocity", "m/s", 0.05, 10.0, "1 in the thesis' code")] = 1.0
    climb_max_m_s: Annotated[float, number("largest velocity upward", "m/s", 0.05, 5.0)] = 0.5
    descent_rate_max_m_s: Annotated[float, number("largest velocity downward", "m/s", 0.05, 5.0)] = 0.5
    turn_max_deg_s: Annotated[float, number("largest turn rate", "deg/s", 1.0, 360.0)] = 34.4
    integral_max_m_s: Annotated[
        float, number("what the integral alone may ask for on one axis: the pad's own speed and the wind", "m/s", 0.0, 10.0)
    ] = 0.5
    soft_above_m: Annotated[
        float,
        number(
            "set points higher than this soften the horizontal gains in proportion", "m", 0.1, 100.0, "2.5 in the thesis' code"
        ),
    ] = 2.5
    soft_least: Annotated[
        float, number("share of the horizontal gains that is left at any height", "1", 0.01, 1.0, "0.1 in the thesis' code")
    ] = 0.1
    forget_after_s: Annotated[float, number("silence of the estimator after which the integrals start anew", "s", 0.1, 60.0)] = (
        2.0
    )
    horizontal: HorizontalGainsSettings = HorizontalGainsSettings()
    vertical: VerticalGainsSettings = VerticalGainsSettings()
    heading: HeadingGainsSettings = HeadingGainsSettings()


class PlannerSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The way down: to a point above the pad, straight down from there, then land. Without sight it never descends."""

    speed_m_s: Annotated[float, number("speed of the set point along the way", "m/s", 0.05, 5.0, "thesis section 4.6")] = 0.4
    slow_radius_m: Annotated[
        float,
        number("within this distance of a way point the set point slows down", "m", 0.01, 20.0, "thesis section 4.6"),
    ] = 1.0
    slow_floor: Annotated[
        float,
        number("share of the speed that is left at the way point itself", "1", 0.01, 1.0, "0.1 in the thesis' code"),
    ] = 0.1
    lead_m: Annotated[float, number("the set point waits for a drone that is farther behind than this", "m", 0.05, 20.0)] = 0.8
    heading: Annotated[
        Literal["keep", "align"], choice("leave the heading alone, or turn until the nose points along the arrow")
    ] = "keep"
    approach_height_m: Annotated[
        float, number("height over the pad of the first way point", "m", 0.3, 50.0, "thesis section 4.6")
    ] = 2.0
    approach_reached_m: Annotated[
        float, number("horizontal distance at which the drone itself counts as there", "m", 0.01, 2.0)
    ] = 0.25
    final_height_m: Annotated[
        float, number("height over the pad from which the drone lands by itself", "m", 0.05, 5.0, "thesis section 4.6")
    ] = 0.3
    final_reached_m: Annotated[
        float,
        number(
            "the same for the last way point",
            "m",
            0.01,
            2.0,
            "0.01 in the thesis, where it held for the set point, not the drone",
        ),
    ] = 0.12
    sigma_land_m: Annotated[
        float,
        number("the drone does not land while one horizontal standard deviation of the estimate is above this", "m", 0.01, 2.0),
    ] = 0.15
    blind_s: Annotated[
        float,
        number("how long after the last sight dead reckoning may fly level towards the pad; 0 to hover at once", "s", 0.0, 30.0),
    ] = 4.0
    touchdown_s: Annotated[
        float,
        number("the drone must still be near the last way point this much later at its present velocity", "s", 0.0, 5.0),
    ] = 0.6
    climb_after_s: Annotated[float, number("time without sight of the pad after which the drone climbs", "s", 0.1, 60.0)] = 1.5
    climb_m_s: Annotated[float, number("how fast it then climbs", "m/s", 0.05, 2.0)] = 0.3
    safe_height_m: Annotated[float, number("height over the pad at which it stops climbing", "m", 0.5, 50.0)] = 2.0
    give_up_after_s: Annotated[
        float,
        number(
            "time without sight, summed up until sight has held for 5 s, after which it hovers and leaves it to the operator",
            "s",
            0.5,
            600.0,
        ),
    ] = 20.0
    try_s: Annotated[float, number("a try, from the first sight on, ends in a go-around after this long", "s", 5.0, 3600.0)] = (
        _PLAN.try_s
    )
    descend_s: Annotated[float, number("the same for its last leg, straight down", "s", 2.0, 600.0)] = _PLAN.descend_s
    losses_max: Annotated[int, number("losses of sight on the last leg that one try may have", "1", 0, 1000)] = _PLAN.losses_max
    blind_descent_max_m: Annotated[
        float, number("height that one try may lose between a last and a next sight, summed up", "m", 0.05, 10.0)
    ] = _PLAN.blind_descent_max_m
    go_arounds_max: Annotated[int, number("go-arounds after which it hovers and leaves it to the operator", "1", 0, 100)] = (
        _PLAN.go_arounds_max
    )
    another_pad: Annotated[
        Literal["operator", "automatic"],
        choice(
            "who decides when the pad is suddenly seen in a place that no motion explains: the operator, by beginning again; or, "
            "once a flight and only above safe_height_m, another_pad_s of unbroken sight of one pad alone"
        ),
    ] = _PLAN.another_pad
    another_pad_s: Annotated[float, number("that sight", "s", 1.0, 120.0)] = _PLAN.another_pad_s
    word_wait_s: Annotated[
        float, number("how long it waits for the operator's word about another pad before it gives up", "s", 1.0, 3600.0)
    ] = _PLAN.word_wait_s

    def __post_init__(self) -> None:
        if self.final_height_m >= self.approach_height_m:
            raise ValueError(
                f"final_height_m ({self.final_height_m:g} m) must be below approach_height_m ({self.approach_height_m:g} m)"
            )
        if self.climb_after_s >= self.give_up_after_s:
            raise ValueError(
                f"climb_after_s ({self.climb_after_s:g} s) must be shorter than give_up_after_s ({self.give_up_after_s:g} s)"
            )


class GuidanceSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """From the belief to commands."""

    start: Annotated[
        Literal["automatic", "signal"],
        choice("approach as soon as the vehicle flies and the pad is seen, or only after SIGUSR1 (SIGUSR2 pauses it)"),
    ] = "signal"
    rate_hz: Annotated[float, number("commands computed a second", "Hz", 5.0, 200.0, "controller of the thesis: 100 Hz")] = 50.0
    stale_after_s: Annotated[
        float, number("an estimate whose newest sighting is older than this means hover", "s", 0.05, 10.0)
    ] = 0.5
    land_timeout_s: Annotated[
        float,
        number("a landing that takes longer from the land command on is taken back: the drone goes around", "s", 1.0, 120.0),
    ] = _PLAN.land_timeout_s
    pid: PidSettings = PidSettings()
    planner: PlannerSettings = PlannerSettings()


class ServiceSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The process: logging, queues, restarts, health."""

    log_level: Annotated[Literal["debug", "info", "warning", "error"], choice("least important messages that are logged")] = (
        "info"
    )
    sample_queue_items: Annotated[
        int, number("inertial samples that may wait; the oldest is dropped and counted", "samples", 16, 100_000)
    ] = 4096
    restart_first_s: Annotated[float, number("rest of a failed part before its first restart", "s", 0.01, 60.0)] = 0.2
    restart_factor: Annotated[float, number("how much longer each further rest is", "1", 1.0, 10.0)] = 2.0
    restart_cap_s: Annotated[float, number("longest rest", "s", 0.01, 600.0)] = 5.0
    restart_healthy_after_s: Annotated[
        float, number("a part that stayed up this long starts over with the first rest", "s", 0.1, 3600.0)
    ] = 5.0
    health_period_s: Annotated[float, number("how often health is written to the log; 0 for never", "s", 0.0, 3600.0)] = 10.0

    def __post_init__(self) -> None:
        if self.restart_cap_s < self.restart_first_s:
            raise ValueError(
                f"restart_cap_s ({self.restart_cap_s:g} s) must not be shorter than restart_first_s ({self.restart_first_s:g} s)"
            )


class Settings(Struct, frozen=True, forbid_unknown_fields=True):
    """Everything a person can set. `companion.config.settings.load` reads one from a file."""

    vehicle: ArDroneSettings | AutopilotSettings
    camera: CameraSettings
    pad: PadSettings
    vision: VisionSettings = VisionSettings()
    estimator: EstimatorOptions = EstimatorOptions()
    guidance: GuidanceSettings = GuidanceSettings()
    service: ServiceSettings = ServiceSettings()
    recorder: RecorderSettings = RecorderSettings()
    mqtt: MqttSettings = MqttSettings()
    metrics: MetricsSettings = MetricsSettings()
    bridge: BridgeSettings = BridgeSettings()

    def fault(self) -> str | None:
        """What does not go together, beginning with the key; None when all does."""
        if fault := self.camera.fault():
            return f"camera.{fault}"
        if isinstance(self.vehicle, AutopilotSettings):
            if self.camera.source == "vehicle":
                return 'camera.source must be "v4l2" or "stream": an autopilot has no frames'
            if self.bridge.links:
                return "bridge.links must be empty: an autopilot speaks MAVLink itself"
        return None
