"""From settings to the options of the MAVLink links, the autopilot's driver and what is told of the pad."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from pathlib import Path

from companion.config.vehicle import AutopilotSettings, BridgeSettings, endpoints, unsigned
from companion.mavlink.component import ComponentOptions
from companion.mavlink.outputs import OutputOptions
from drivers.mavlink.access import parse_operators
from drivers.mavlink.autopilot import AutopilotOptions
from drivers.mavlink.links import LinkOptions
from drivers.mavlink.setpoint_streamer import StreamerOptions
from drivers.mavlink.signing import Signing, load_key
from drivers.mavlink.signing_times import SigningTimes

_log = logging.getLogger(__name__)


def links(settings: AutopilotSettings | BridgeSettings, environment: Mapping[str, str] | None = None) -> tuple[LinkOptions, ...]:
    """The links that are set; where they are signed, each under a link id of its own.

    Raises:
        BadInput: no link, or a key that cannot be read.
    """
    found = endpoints(settings.links)
    if not settings.signing_key_file:
        level = logging.INFO if all(endpoint.is_private for endpoint in found) else logging.WARNING
        if found:
            _log.log(level, "MAVLink over %s is %s", settings.links, unsigned(settings))
        return tuple(LinkOptions(endpoint) for endpoint in found)
    environment = os.environ if environment is None else environment
    key = load_key(settings.signing_key_file, environment)
    file = _time_file(settings.signing_time_file, environment)
    if file is None:
        _log.warning(
            "signing times are kept in memory alone: after a restart, messages up to a minute old could be played again; "
            "set signing_time_file, or let systemd give a StateDirectory"
        )
    times = SigningTimes(file)
    return tuple(LinkOptions(endpoint, signing=Signing(key, times, number)) for number, endpoint in enumerate(found))


def autopilot_options(
    settings: AutopilotSettings, sample_line: int, parameters: tuple[str, ...], environment: Mapping[str, str] | None = None
) -> AutopilotOptions:
    """How the autopilot is reached and flown.

    Args:
        sample_line: samples that may wait.
        parameters: of the autopilot, to be read on each connect.

    Raises:
        BadInput: as `links`.
    """
    return AutopilotOptions(
        links(settings, environment),
        system=settings.system_id or None,
        vessel_system=settings.vessel_id or None,
        operators=parse_operators(settings.operators),
        component=settings.component_id,
        silence_s=settings.silence_s,
        period_s=settings.command_period_s,
        parameters=parameters,
        sample_line=sample_line,
        streamer=StreamerOptions(
            command_timeout_s=settings.command_timeout_s,
            take_off_height_m=settings.take_off_height_m,
            landing=settings.landing,
            descent_rate_m_s=settings.descent_rate_m_s,
        ),
    )


def component_options(settings: AutopilotSettings, pad_radius_m: float, stale_s: float) -> ComponentOptions:
    """What is told of the pad, and how often.

    Args:
        stale_s: a pad not seen for this long is no longer told of.
    """
    return ComponentOptions(
        OutputOptions(
            pad_radius_m,
            rate_hz=settings.target_rate_hz,
            stale_s=stale_s,
            ranges=settings.ranges,
            range_rate_hz=settings.range_rate_hz,
            ground_clearance_m=settings.ground_clearance_m,
            vision_target_estimator=settings.vision_target_estimator,
        )
    )


def _time_file(named: str, environment: Mapping[str, str]) -> Path | None:
    if named:
        return Path(named)
    state = environment.get("STATE_DIRECTORY")
    return Path(state) / "mavlink-signing-time" if state else None
