"""Find keys without effect, because another key switches their part off or because they are retired, and moved keys."""

import copy
import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from msgspec import NODEFAULT, Struct

from companion.settings.expert import in_file
from companion.settings.model import Settings
from companion.settings.ship_place import sources
from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.errors import BadInput

log = logging.getLogger(__name__)

RETIRED = {
    "guidance.pid.heading.kd": (0.0, "the estimate tells no rate of the heading"),
    "estimator.ekf.sigma_sway_per_heave": (0.2, "sway is estimated without the heave"),
    "estimator.ekf.asd_sway_per_heave": (5e-3, "sway is estimated without the heave"),
}
"""Retired keys that older files and recordings have: their default, and the reason. They are read and ignored."""

MOVED = {
    "vehicle.target_rate_hz": "landing_target.rate_hz",
    "vehicle.ranges": "landing_target.ranges",
    "vehicle.range_rate_hz": "landing_target.range_rate_hz",
    "vehicle.ground_clearance_m": "landing_target.ground_clearance_m",
    "vehicle.vision_target_estimator": "landing_target.vision_target_estimator",
    "estimator.integrity.place_step_share": "estimator.integrity.place_step_fraction",
    "estimator.integrity.range_tolerance_share": "estimator.integrity.range_tolerance_fraction",
    "estimator.integrity.range_doubt_s": "estimator.integrity.range_disagree_s",
}
"""Keys that have another name now. A settings file with the old name is refused; a recording is read with the new one."""

_INTO_HTTP = ("page", "metrics", "foxglove")
"""Tables that are one table [http] now. A settings file with them is refused; a recording is read without them."""


@dataclass(frozen=True, slots=True)
class _Rule:
    keys: str
    """One key, several with commas between, or a table with a dot at its end."""
    idle: Callable[[Settings], bool]
    why: str
    but: str = ""
    """Keys of the table that have an effect all the same."""


_RULES = (
    _Rule("vision.learned_file", lambda s: s.vision.learned == "off", 'vision.learned is "off"'),
    _Rule("guidance.policy_file", lambda s: s.guidance.controller != "policy", 'guidance.controller is not "policy"'),
    _Rule("mqtt.", lambda s: s.mqtt.transport == "off", 'mqtt.transport is "off"', "mqtt.transport"),
    _Rule("mqtt.ca_file,mqtt.certificate_file,mqtt.key_file", lambda s: s.mqtt.transport == "tcp", 'mqtt.transport is "tcp"'),
    _Rule("mqtt.commands_max_hz", lambda s: s.mqtt.transport != "off" and s.mqtt.commands == "off", 'mqtt.commands is "off"'),
    _Rule("http.", lambda s: s.http.endpoint == "off", 'http.endpoint is "off"', "http.endpoint"),
    _Rule("video_stream.", lambda s: not s.video_stream.to, "video_stream.to is empty", "video_stream.to"),
    _Rule("http.certificate_file,http.key_file", lambda s: s.http.endpoint == "http", 'http.endpoint is "http"'),
    _Rule("http.hosts,http.picture_codec,http.bitrate_kbit_s", lambda s: not s.http.page, "http.page is false"),
    _Rule("http.origins,http.foxglove_frames", lambda s: not s.http.foxglove, "http.foxglove is false"),
    _Rule("http.origins", lambda s: bool(s.http.token_file), "http.token_file is set"),
    _Rule(
        "limits.fence_radius_m,limits.fence_polygon,limits.fence_brake_s,limits.fence_ends_s",
        lambda s: s.limits.fence == "off",
        'limits.fence is "off"',
    ),
    _Rule(
        "limits.fence_radius_m",
        lambda s: s.limits.fence != "off" and bool(s.limits.fence_polygon),
        "there is limits.fence_polygon",
    ),
    _Rule(
        "guidance.rendezvous.",
        lambda s: not s.guidance.rendezvous.enabled,
        "guidance.rendezvous.enabled is false",
        "guidance.rendezvous.enabled",
    ),
    _Rule("vessel.", lambda s: not sources(s), "no source of the ship's place is set"),
    _Rule("operator.gamepad_device", lambda s: s.operator.gamepad == "off", 'operator.gamepad is "off"'),
    _Rule("landing_target.", lambda s: isinstance(s.vehicle, ArDroneOptions), 'vehicle.kind is "ardrone"'),
    _Rule(
        "camera.gimbal.",
        lambda s: not s.camera.gimbal.given,
        "camera.gimbal.device_id is 0",
        "camera.gimbal.device_id",
    ),
    _Rule(
        "camera.exposure.",
        lambda s: not s.camera.exposure.driven,
        'camera.exposure.mode is "camera"',
        "camera.exposure.mode",
    ),
    _Rule("bridge.", lambda s: not s.bridge.links.strip(), "bridge.links is empty"),
    _Rule("bridge.signing_time_file", lambda s: not s.bridge.signing_key_file, "bridge.signing_key_file is empty"),
    _Rule(
        "vehicle.signing_time_file",
        lambda s: not isinstance(s.vehicle, ArDroneOptions) and not s.vehicle.signing_key_file,
        "vehicle.signing_key_file is empty",
    ),
    _Rule(
        "landing_target.range_rate_hz,landing_target.range_id,landing_target.ground_clearance_m",
        lambda s: s.landing_target.ranges == "off",
        'landing_target.ranges is "off"',
    ),
    _Rule(
        "vehicle.descent_rate_m_s,vehicle.landing_most_s,vehicle.landing_depth_m",
        lambda s: not isinstance(s.vehicle, ArDroneOptions) and s.vehicle.landing == "mode",
        'vehicle.landing is "mode"',
    ),
    _Rule(
        "camera.format,camera.controls,camera.buffers",
        lambda s: s.camera.source != "v4l2",
        'camera.source is not "v4l2"',
    ),
    _Rule(
        "camera.rate_hz,camera.arrival_sigma_s",
        lambda s: s.camera.source not in ("v4l2", "gstreamer"),
        'camera.source is neither "v4l2" nor "gstreamer"',
    ),
    _Rule(
        "camera.repeat",
        lambda s: s.camera.source != "stream" or s.camera.is_live,
        "camera.source and camera.device do not name a video file",
    ),
    _Rule(
        "camera.latency_s,camera.latency_sigma_s,camera.exposure_s,camera.silence_s,camera.reconnect_first_s,"
        "camera.reconnect_most_s",
        lambda s: s.camera.source == "vehicle",
        'camera.source is "vehicle", whose own keys say this',
    ),
    _Rule(
        "estimator.ekf.min_confidence",
        lambda s: s.estimator.ekf.min_confidence <= s.estimator.min_confidence,
        "it does not exceed estimator.min_confidence, which refuses before",
    ),
    _Rule(
        "estimator.dead_reckoning.calibration_samples,estimator.dead_reckoning.calibration_velocity_max_m_s,"
        "estimator.dead_reckoning.calibration_acceleration_max_m_s2",
        lambda s: s.estimator.dead_reckoning.calibration_s == 0.0,
        "estimator.dead_reckoning.calibration_s is 0",
    ),
    _Rule(
        "estimator.dead_reckoning.history_s",
        lambda s: s.estimator.dead_reckoning.history_s < s.estimator.max_delay_s,
        "it is shorter than estimator.max_delay_s, which is taken instead",
    ),
    _Rule(
        "guidance.tries.another_pad_s",
        lambda s: s.guidance.tries.another_pad == "operator",
        'guidance.tries.another_pad is "operator"',
    ),
    _Rule("recorder.jpeg_quality", lambda s: s.recorder.frames != "jpeg", 'recorder.frames is not "jpeg"'),
    _Rule("recorder.frames_each", lambda s: s.recorder.frames == "none", 'recorder.frames is "none"'),
)


def without_effect(settings: Settings) -> tuple[str, ...]:
    """Return a line for every cause that leaves keys without effect; keys at their default are omitted."""
    changed = set(_changed(settings))
    lines = []
    for rule in _RULES:
        if rule.keys.endswith("."):
            idle = {path for path in changed if path.startswith(rule.keys)} - {rule.but}
        else:
            idle = changed.intersection(rule.keys.split(","))
        if idle and rule.idle(settings):
            changed -= idle
            lines.append(f"{', '.join(map(in_file, sorted(idle)))}: without effect, as {rule.why}")
    return tuple(lines)


def without_retired(data: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """Return the data of a settings file without retired keys; log those that differ from their default."""
    for path, (default, why) in RETIRED.items():
        found = _found(data, path)
        if found is None:
            continue
        if found != default:
            log.warning("%s: %s is retired and left out: %s", where, path, why)
        data = _without(data, path)
    return data


def refuse_moved(data: Mapping[str, Any]) -> None:
    """Refuse a settings file that has a key under its old name.

    Raises:
        BadInput: the file has such a key; the text names the new one.
    """
    for old, new in MOVED.items():
        if _found(data, old) is not None:
            raise BadInput(f"{old} is now {in_file(new)}")
    for table in _INTO_HTTP:
        if table in data:
            raise BadInput(f"{table} is now a part of the table [http] (docs/page.md)")


def with_moved(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the settings of a recording with moved keys under their new names; if a key has both names, the new one counts."""
    data = {name: table for name, table in data.items() if name not in _INTO_HTTP}
    for old, new in MOVED.items():
        value = _found(data, old)
        if value is None:
            continue
        kept = table = _without(data, old)
        *tables, last = new.split(".")
        for name in tables:
            table = table.setdefault(name, {})
            if not isinstance(table, dict):
                break  # the refusal of what stands there in place of a table says more
        else:
            table.setdefault(last, value)
            data = kept
    return data


def _found(data: Mapping[str, Any], path: str) -> object:
    """Return the value at the dotted path, or None if there is none."""
    value: Any = data
    for name in path.split("."):
        value = value.get(name) if isinstance(value, Mapping) else None
    return value


def _without(data: Mapping[str, Any], path: str) -> dict[str, Any]:
    *tables, last = path.split(".")
    kept = inner = copy.deepcopy(dict(data))
    for name in tables:
        inner = inner[name]
    del inner[last]
    return kept


def _changed(table: Struct, prefix: str = "") -> Iterator[str]:
    """Yield the dotted path of each key whose value is not its default; keys without a default are omitted.

    The defaults come from the structs; to describe the whole model first, as `refusal.walk` does, takes far longer.
    """
    names, defaults = table.__struct_fields__, table.__struct_defaults__
    required = len(names) - len(defaults)
    for i, name in enumerate(names):
        value = getattr(table, name)
        if isinstance(value, Struct):
            yield from _changed(value, f"{prefix}{name}.")
        elif i >= required and defaults[i - required] is not NODEFAULT and value != defaults[i - required]:
            yield prefix + name
