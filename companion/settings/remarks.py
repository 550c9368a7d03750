"""Say of settings that are good what their author may want to know, such as keys that another key leaves without effect."""

import json
import re
from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from pathlib import Path
from typing import NamedTuple

import msgspec
from msgspec import NODEFAULT, Struct

from companion.settings.load import camera_model, find_file, lens_assumed, mount_assumed
from companion.settings.mission import ConeOptions
from companion.settings.model import Settings, in_file
from companion.settings.sound import beyond_sound
from drivers.camera.options import DRIVEN_SOURCES


class Contradiction(Struct, frozen=True):
    """Settings that are good each for itself and do not go together."""

    what: str
    fix: str
    refuses: bool
    """True if the drone refuses every landing that begins out of sight of the pad; otherwise something is only unused."""


def sources(settings: Settings) -> tuple[str, ...]:
    """Return the keys that name a source of the ship's place."""
    return tuple(key for key in _source_keys(settings) if _at(settings, key))


def _source_keys(settings: Settings) -> list[str]:
    """Return the keys that name a source of the ship's place if they are set."""
    vehicle = settings.vehicle.ship_keys
    return [*(f"vessel.{key}" for key in settings.vessel.source_keys), *(f"vehicle.{key}" for key in vehicle)]


def contradiction(settings: Settings) -> Contradiction | None:
    """Return what does not go together about the ship's place, or None."""
    reported, flies_there = sources(settings), settings.guidance.rendezvous.enabled
    if flies_there and not reported:
        return Contradiction(
            "guidance.rendezvous.enabled is true, but nothing tells where the ship is",
            f"set a source ({', '.join(_source_keys(settings))}), or the drone refuses where the pad is not in sight",
            refuses=True,
        )
    if reported and not flies_there:
        return Contradiction(
            f"{', '.join(reported)}: the ship's velocity and heading are used, her place is not",
            "set guidance.rendezvous.enabled = true to fly to it",
            refuses=False,
        )
    if why := settings.vessel.reported_too_rarely(reported):
        return Contradiction(
            f"expert.vessel.age_max_s is {settings.vessel.age_max_s:g} s, but {why}",
            "where no other sentences give her place, set age_max_s = 12 and a smaller acceleration_m_s2 in [expert.vessel]",
            refuses=False,
        )
    return None


_Cause = tuple[str, Callable[[Settings], bool]]
"""The cause as it is printed, and whether settings have it."""


def _at(settings: Settings, path: str) -> object:
    """Return the value of a key, text without blanks around it; None of one that this kind of table does not have."""
    *tables, last = path.split(".")
    table: Struct = reduce(getattr, tables, settings)
    config = table.__struct_config__
    found = config.tag if last == config.tag_field else getattr(table, last, None)
    return found.strip() if isinstance(found, str) else found


def _is(key: str, value: object) -> _Cause:
    return f"{key} is {json.dumps(value) if value != '' else 'empty'}", lambda s: _at(s, key) == value


def _is_not(key: str, value: object) -> _Cause:
    return f"{key} is {f'not {json.dumps(value)}' if value != '' else 'set'}", lambda s: _at(s, key) not in (value, None)


class _Rule(NamedTuple):
    keys: str
    """One key, several with blanks between, or a table with a dot at its end."""
    cause: _Cause
    but: str = ""
    """A key of the table that has an effect all the same."""


_RULES = (
    _Rule("vision.learned_file", _is("vision.learned", "off")),
    _Rule("guidance.policy_file", _is_not("guidance.controller", "policy")),
    _Rule(
        "guidance.pid.",
        (
            'guidance.controller is not "pid" and estimator.path is "ekf"',
            lambda s: s.guidance.controller in ("follow_deck", "policy") and s.estimator.path == "ekf",
        ),
    ),
    _Rule("guidance.thesis.", _is_not("guidance.mission", "thesis")),
    _Rule("guidance.elsewhere.", _is_not("guidance.refused", "land elsewhere")),
    _Rule("mqtt.", _is("mqtt.transport", "off"), "mqtt.transport"),
    _Rule("mqtt.ca_file mqtt.certificate_file mqtt.key_file", _is("mqtt.transport", "tcp")),
    _Rule("mqtt.commands_max_hz", _is("mqtt.commands", "off")),
    _Rule("http.", _is("http.endpoint", "off"), "http.endpoint"),
    _Rule("video_stream.", _is("video_stream.to", ""), "video_stream.to"),
    _Rule("http.certificate_file http.key_file", _is("http.endpoint", "http")),
    _Rule("http.hosts http.picture_codec http.bitrate_kbit_s", _is("http.page", False)),
    _Rule("http.origins http.foxglove_frames", _is("http.foxglove", False)),
    _Rule("http.origins", _is_not("http.token_file", "")),
    _Rule("limits.fence_radius_m limits.fence_polygon limits.fence_brake_s limits.fence_ends_s", _is("limits.fence", "off")),
    _Rule("limits.fence_radius_m", _is_not("limits.fence_polygon", "")),
    _Rule("guidance.rendezvous.", _is("guidance.rendezvous.enabled", False), "guidance.rendezvous.enabled"),
    _Rule("vessel.", ("no source of the ship's place is set", lambda s: not sources(s))),
    _Rule("operator.gamepad_device", _is("operator.gamepad", "off")),
    _Rule("landing_target.", ("the vehicle takes no LANDING_TARGET", lambda s: not s.vehicle.takes_targets)),
    _Rule("camera.gimbal.", _is("camera.gimbal.device_id", 0), "camera.gimbal.device_id"),
    _Rule("camera.exposure.", _is("camera.exposure.mode", "camera"), "camera.exposure.mode"),
    _Rule("bridge.", _is("bridge.links", "")),
    _Rule("bridge.signing_time_file", _is("bridge.signing_key_file", "")),
    _Rule("vehicle.signing_time_file", _is("vehicle.signing_key_file", "")),
    _Rule(
        "landing_target.range_rate_hz landing_target.range_id landing_target.ground_clearance_m",
        _is("landing_target.ranges", "off"),
    ),
    _Rule("vehicle.descent_rate_m_s", _is("vehicle.landing", "mode")),
    _Rule("camera.format camera.buffers", _is_not("camera.source", "v4l2")),
    _Rule(
        "camera.controls",
        ('camera.source is neither "v4l2" nor "libcamera"', lambda s: s.camera.source not in DRIVEN_SOURCES),
    ),
    _Rule(
        "camera.rate_hz camera.arrival_sigma_s",
        ('camera.source is "vehicle" or "stream"', lambda s: s.camera.source in ("vehicle", "stream")),
    ),
    _Rule(
        "camera.repeat",
        ("camera.source and camera.device do not name a video file", lambda s: s.camera.source != "stream" or s.camera.is_live),
    ),
    _Rule(
        "camera.latency_s camera.latency_sigma_s camera.exposure_s camera.silence_s camera.reconnect_first_s "
        "camera.reconnect_most_s",
        ('camera.source is "vehicle", whose own keys say this', lambda s: s.camera.source == "vehicle"),
    ),
    _Rule(
        "estimator.dead_reckoning.history_s",
        (
            "it is shorter than estimator.max_delay_s, which is taken instead",
            lambda s: s.estimator.dead_reckoning.history_s < s.estimator.max_delay_s,
        ),
    ),
    _Rule("recorder.jpeg_quality", _is_not("recorder.frames", "jpeg")),
)
"""The first rule that holds explains a key."""


def remarks(settings: Settings) -> tuple[str, ...]:
    """Return a line for each thing in good settings that is hardly what their author meant."""
    found = contradiction(settings)
    contradicting = () if found is None else (f"{found.what}: {found.fix}",)
    mount = mount_assumed(find_file(settings.camera.file, "cameras", Path(), "camera.file"))
    said = *_empty_battery(settings), *_feet(settings), *_numbered_ports(settings), *lens_assumed(camera_model(settings))
    return (*without_effect(settings), *contradicting, *beyond_sound(settings), *said, *mount)


def _empty_battery(settings: Settings) -> tuple[str, ...]:
    """Return that a drone which refuses hovers until its battery is empty, where the settings say so."""
    o = settings.guidance
    leaves = o.refused != "hold" and settings.vehicle.returns
    return (
        () if leaves or o.last_charge > 0.0 else ("expert.guidance.last_charge is 0: a drone that refused hovers until it falls",)
    )


def _feet(settings: Settings) -> tuple[str, ...]:
    """Return that a vehicle of other feet has those of the defaults."""
    its_m = ConeOptions().feet_below_m
    if settings.vehicle.has_default_feet or settings.guidance.cone.feet_below_m != its_m:
        return ()
    return (f"guidance.cone.feet_below_m is {its_m:g} m, an AR.Drone's: taller feet touch before the deck is expected",)


def _numbered_ports(settings: Settings) -> tuple[str, ...]:
    """Return a warning about two serial ports that are named by their numbers."""
    ports = sorted(set(re.findall(r"/dev/tty(?:USB|ACM)\d+", msgspec.json.encode(settings, enc_hook=str).decode())))
    if len(ports) < 2:
        return ()
    return (f"{' and '.join(ports)} may change places at the next start: name them by /dev/serial/by-id/... or by-path/...",)


def not_checked(keys: Sequence[str]) -> str:
    """Return a remark about settings that name systemd credentials, which exist only inside the unit; "" if there are none."""
    return f" ({', '.join(keys)}: credentials of the systemd unit, not checked here)" if keys else ""


def without_effect(settings: Settings) -> tuple[str, ...]:
    """Return a line for every cause that leaves keys without effect; keys at their default are omitted."""
    changed = set(_changed(settings))
    lines = []
    for rule in _RULES:
        if rule.keys.endswith("."):
            idle = {path for path in changed if path.startswith(rule.keys)} - {rule.but}
        else:
            idle = changed.intersection(rule.keys.split())
        why, holds = rule.cause
        if idle and holds(settings):
            changed -= idle
            lines.append(f"{', '.join(map(in_file, sorted(idle)))}: without effect, as {why}")
    return tuple(lines)


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
