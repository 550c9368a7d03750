"""The configuration of an AR.Drone: the keys of a 2.0, who may write them, the sets kept for each session, user and application.

Source: Parrot AR.Drone SDK 2.0 developer guide, chapter 8 (configuration, multi-configuration); key names and defaults as a
drone answers on port 5559.
"""

import math
import re
from collections.abc import Iterator, Mapping
from enum import Enum
from typing import Literal

from msgspec import Struct, structs

from drivers.ardrone import control

DEFAULT_ID = "00000000"
"""The id of the set that every client shares; nothing needs to be declared to write into it."""

Kind = Literal["int", "float", "bool", "text"]


class Scope(Enum):
    """The set to which a key belongs. `COMMON` is one set for the whole drone; the others have one for each id."""

    COMMON = "common"
    APPLICATION = "applis"
    USER = "profiles"
    SESSION = "sessions"


class Key(Struct, frozen=True):
    """One line of the configuration."""

    name: str
    default: str
    kind: Kind = "int"
    scope: Scope = Scope.COMMON
    writable: bool = True
    low: float = -math.inf
    high: float = math.inf
    choices: frozenset[str] = frozenset()
    """The only values taken; empty for any that the other rules let through."""


class Answer(Enum):
    """The result of one attempt to set a key."""

    SET = "set"
    UNKNOWN_KEY = "unknown_key"
    READ_ONLY = "read_only"
    BAD_VALUE = "bad_value"
    WRONG_IDS = "wrong_ids"
    """The key belongs to a session, user or application that the client did not name just before."""


class Ids(Struct, frozen=True):
    """Eight lower-case hexadecimal digits each."""

    session: str = DEFAULT_ID
    user: str = DEFAULT_ID
    application: str = DEFAULT_ID

    def of(self, scope: Scope) -> str:
        return {Scope.SESSION: self.session, Scope.USER: self.user, Scope.APPLICATION: self.application}.get(scope, DEFAULT_ID)


_ID_KEYS = {
    "custom:session_id": Scope.SESSION,
    "custom:profile_id": Scope.USER,
    "custom:application_id": Scope.APPLICATION,
}
_DESCRIPTION_KEYS = {
    Scope.APPLICATION: "custom:application_desc",
    Scope.USER: "custom:profile_desc",
    Scope.SESSION: "custom:session_desc",
}
_ID = re.compile(r"[0-9a-f]{8}")

_LIMITS = ("euler_angle_max", "control_vz_max", "control_yaw")
"""Keys with an indoor and an outdoor twin: control:outdoor says which one rules."""
LIMIT_KEYS = frozenset(f"control:{where}{name}" for where in ("", "indoor_", "outdoor_") for name in _LIMITS)


def _fixed(name: str, default: str, kind: Kind = "text") -> Key:
    return Key(name, default, kind, writable=False)


def _limits() -> Iterator[Key]:
    for where, angle, vz, yaw in (
        ("", "0.20943952", "700", "1.7453293"),
        ("indoor_", "0.20943952", "700", "1.7453293"),
        ("outdoor_", "0.34906584", "1000", "3.4906585"),
    ):
        yield Key(f"control:{where}euler_angle_max", angle, "float", Scope.USER, low=0.0, high=0.52)
        yield Key(f"control:{where}control_vz_max", vz, "float", Scope.USER, low=100.0, high=2000.0)
        yield Key(f"control:{where}control_yaw", yaw, "float", Scope.USER, low=0.1, high=6.11)


def tilting(keys: Mapping[str, Key], most_rad: float) -> Mapping[str, Key]:
    """Return the keys of a vehicle that takes tilts up to another one than the AR.Drone's firmware does."""
    return {name: structs.replace(key, high=most_rad) if name.endswith("euler_angle_max") else key for name, key in keys.items()}


def _table() -> Iterator[Key]:
    yield _fixed("general:num_version_config", "1", "int")
    yield _fixed("general:num_version_mb", "33", "int")
    yield _fixed("general:num_version_soft", "2.4.8")
    yield _fixed("general:drone_serial", "PS721000SIMULATED")
    yield _fixed("general:soft_build_date", "2014-07-03 12:00")
    for motor in range(1, 5):
        for part, text in (("soft", "1.43"), ("hard", "6.0"), ("supplier", "1.1")):
            yield _fixed(f"general:motor{motor}_{part}", text)
    yield Key("general:ardrone_name", "Decklander", "text")
    yield _fixed("general:flying_time", "0", "int")
    yield Key("general:navdata_demo", "FALSE", "bool")
    yield Key("general:navdata_options", "65537", scope=Scope.APPLICATION, low=0, high=2**32 - 1)
    yield Key("general:com_watchdog", "2", low=1, high=60)
    yield Key("general:video_enable", "TRUE", "bool")
    yield Key("general:vision_enable", "TRUE", "bool")
    yield _fixed("general:vbat_min", "9000", "int")
    yield Key("general:localtime", "0")

    yield Key("control:control_level", "0", scope=Scope.APPLICATION)
    yield from _limits()
    yield Key("control:altitude_max", "3000", low=500, high=100_000)
    yield Key("control:altitude_min", "50", low=50, high=100_000)
    yield Key("control:control_trim_z", "0.0", "float", Scope.USER)
    yield Key("control:control_iphone_tilt", "0.34906584", "float", Scope.USER, low=0.0, high=0.88)
    for name in ("outdoor", "flight_without_shell", "autonomous_flight"):
        yield Key(f"control:{name}", "FALSE", "bool")
    yield Key("control:brushless", "TRUE", "bool")
    yield Key("control:manual_trim", "FALSE", "bool", Scope.USER)
    yield Key("control:flying_mode", "0", scope=Scope.SESSION, choices=frozenset("012"))
    yield Key("control:hovering_range", "1000", scope=Scope.SESSION, low=0, high=100_000)
    yield Key("control:flight_anim", "0,0", "text")
    yield _fixed("control:accs_offset", control.format_vector((-2048.0, 2048.0, 2048.0)))
    yield _fixed("control:magneto_offset", control.format_vector((0.0, 0.0, 0.0)))

    for name in ("ssid_single_player", "ssid_multi_player"):
        yield Key(f"network:{name}", "ardrone2_simulated", "text")
    yield Key("network:wifi_mode", "0")
    yield Key("network:owner_mac", "00:00:00:00:00:00", "text")
    for name, port in (("navdata_port", 5554), ("video_port", 5555), ("at_port", 5556), ("cmd_port", 5559)):
        yield _fixed(f"network:{name}", str(port), "int")

    yield Key("pic:ultrasound_freq", "8", choices=frozenset("78"))
    yield Key("pic:ultrasound_watchdog", "3")
    yield _fixed("pic:pic_version", "184877088", "int")

    yield _fixed("video:camif_fps", "30", "int")
    yield Key("video:video_codec", "129", scope=Scope.SESSION, choices=frozenset({"129"}))
    yield Key("video:video_channel", "0", scope=Scope.SESSION, choices=frozenset("0123"))
    yield Key("video:codec_fps", "30", scope=Scope.SESSION, low=15, high=30)
    yield Key("video:max_bitrate", "4000", scope=Scope.SESSION, low=250, high=20_000)
    yield Key("video:bitrate", "1000", scope=Scope.APPLICATION, low=0, high=20_000)
    yield Key("video:bitrate_ctrl_mode", "0", scope=Scope.APPLICATION, choices=frozenset("012"))
    yield Key("video:bitrate_storage", "2000", scope=Scope.APPLICATION)
    yield Key("video:video_on_usb", "FALSE", "bool")
    yield Key("video:video_slices", "0")
    yield Key("video:video_live_socket", "0")

    yield Key("leds:leds_anim", "0,0,0", "text")
    yield Key("detect:enemy_colors", "1", choices=frozenset("123"))
    yield Key("detect:enemy_without_shell", "0")
    yield Key("detect:groundstripe_colors", "16", scope=Scope.SESSION)
    yield Key("detect:detect_type", "3", scope=Scope.SESSION, low=0, high=20)
    for name in ("detections_select_h", "detections_select_v_hsync", "detections_select_v"):
        yield Key(f"detect:{name}", "0", scope=Scope.SESSION, low=0, high=2**32 - 1)
    yield Key("userbox:userbox_cmd", "0", "text", Scope.SESSION)
    for name in ("latitude", "longitude", "altitude"):
        yield Key(f"gps:{name}", "5.0000000000000000e+02", "float", Scope.SESSION)
    yield Key("syslog:output", "7")
    yield Key("syslog:max_size", "102400")
    yield Key("syslog:nb_files", "5")

    # Which user and application a session flies with is part of the session: choosing it again brings them back.
    yield Key("custom:application_id", DEFAULT_ID, "text", Scope.SESSION)
    yield Key("custom:application_desc", "Default application configuration", "text", Scope.APPLICATION)
    yield Key("custom:profile_id", DEFAULT_ID, "text", Scope.SESSION)
    yield Key("custom:profile_desc", "Default profile configuration", "text", Scope.USER)
    yield Key("custom:session_id", DEFAULT_ID, "text")
    yield Key("custom:session_desc", "Default session configuration", "text", Scope.SESSION)


KEYS: Mapping[str, Key] = {key.name: key for key in _table()}
"""The keys of a 2.0 with firmware 2.4.8."""


class Configuration:
    """All values, with one set for each known session, user and application."""

    def __init__(self, ports: Mapping[str, int] | None = None, keys: Mapping[str, Key] = KEYS) -> None:
        """`ports`: what network:navdata_port, video_port, at_port and cmd_port say, where they are not the usual ones."""
        self._keys = keys
        self._known: dict[str, str] = {}
        """Values that were read since a key was written last."""
        self._common = {k.name: k.default for k in keys.values() if k.scope is Scope.COMMON}
        for name, port in (ports or {}).items():
            self._common[f"network:{name}"] = str(port)
        self._sets: dict[Scope, dict[str, dict[str, str]]] = {
            scope: {DEFAULT_ID: {k.name: k.default for k in keys.values() if k.scope is scope}}
            for scope in (Scope.APPLICATION, Scope.USER, Scope.SESSION)
        }

    @property
    def ids(self) -> Ids:
        """The ids in use."""
        session = self._common["custom:session_id"]
        chosen = self._sets[Scope.SESSION][session]
        return Ids(session, chosen["custom:profile_id"], chosen["custom:application_id"])

    def __getitem__(self, name: str) -> str:
        value = self._known.get(name)
        if value is None:
            value = self._known[name] = self._stored(name)
        return value

    def flag(self, name: str) -> bool:
        """Return the value of a key that is TRUE or FALSE."""
        return self[name] == "TRUE"

    def number(self, name: str) -> float:
        """Return the value of a key that is a number."""
        return float(self[name])

    def set(self, name: str, value: str, ids: Ids | None = None) -> Answer:
        """Write one key as a client requested.

        Args:
            ids: what the client's CONFIG_IDS just before named; None when there was none.
        """
        self._known.clear()
        name, value = name.strip().lower(), value.strip()
        key = self._keys.get(name)
        if key is None:
            return Answer.UNKNOWN_KEY
        if name in _ID_KEYS:
            return self._choose(_ID_KEYS[name], value.lower())
        if not key.writable:
            return Answer.READ_ONLY
        in_use = self.ids.of(key.scope)
        if in_use != DEFAULT_ID and (ids is None or ids.of(key.scope) != in_use):
            return Answer.WRONG_IDS
        written = _normal(key, value)
        if written is None:
            return Answer.BAD_VALUE
        self._home(key)[name] = written
        self._keep_twins(name)
        return Answer.SET

    def fix(self, name: str, value: str) -> None:
        """Give a common key that no client may write the value that this drone has."""
        self._known.clear()
        self._common[name] = value

    def dump(self) -> dict[str, str]:
        """Every key with the value in force, in the table's order."""
        return {name: self[name] for name in self._keys}

    def custom_ids(self) -> bytes:
        """List the sets as CTRL 6 sends them: `[applis]`, `[profiles]`, `[sessions]`, each followed by `id,description`.

        Lines end with a carriage return and the whole with a NUL, as the SDK's reader wants it.
        """
        lines: list[str] = []
        for scope, sets in self._sets.items():
            lines.append(f"[{scope.value}]")
            lines += [f"{id_},{values[_DESCRIPTION_KEYS[scope]]}" for id_, values in sets.items()]
        return "".join(f"{line}\r" for line in lines).encode("ascii", "replace") + b"\0"

    def _stored(self, name: str) -> str:
        return self._home(self._keys[name])[name]

    def _home(self, key: Key) -> dict[str, str]:
        return self._common if key.scope is Scope.COMMON else self._sets[key.scope][self.ids.of(key.scope)]

    def _choose(self, scope: Scope, id_: str) -> Answer:
        sets = self._sets[scope]
        if id_.startswith("-"):
            doomed = [i for i in sets if i != DEFAULT_ID and id_ in ("-all", f"-{i}")]
            if not doomed:
                return Answer.BAD_VALUE
            if self.ids.of(scope) in doomed:
                self._use(scope, DEFAULT_ID)
            for i in doomed:
                del sets[i]
            self._forget(scope, doomed)
            return Answer.SET
        if not _ID.fullmatch(id_):
            return Answer.BAD_VALUE
        sets.setdefault(id_, dict(sets[DEFAULT_ID]))
        self._use(scope, id_)
        return Answer.SET

    def _use(self, scope: Scope, id_: str) -> None:
        name = next(n for n, s in _ID_KEYS.items() if s is scope)
        self._home(self._keys[name])[name] = id_

    def _forget(self, scope: Scope, doomed: list[str]) -> None:
        if scope is Scope.SESSION:
            return
        name = next(n for n, s in _ID_KEYS.items() if s is scope)
        for values in self._sets[Scope.SESSION].values():
            if values[name] in doomed:
                values[name] = DEFAULT_ID

    def _keep_twins(self, name: str) -> None:
        where = "outdoor_" if self._stored("control:outdoor") == "TRUE" else "indoor_"
        section, _, short = name.partition(":")
        if section != "control":
            return
        for limit in _LIMITS:
            ruling, twin = f"control:{limit}", f"control:{where}{limit}"
            if short == limit:
                self._home(self._keys[twin])[twin] = self._stored(ruling)
            elif short in ("outdoor", f"{where}{limit}"):
                self._home(self._keys[ruling])[ruling] = self._stored(twin)


def _normal(key: Key, value: str) -> str | None:
    """Return the text that is stored for `value`, or None if the key refuses it."""
    if len(value) > 255 or any(ord(c) < 32 for c in value):
        return None
    if key.kind == "bool":
        return {"true": "TRUE", "1": "TRUE", "false": "FALSE", "0": "FALSE"}.get(value.lower())
    if key.kind in ("int", "float"):
        try:
            number = int(value) if key.kind == "int" else float(value)
        except ValueError:
            return None
        if not key.low <= number <= key.high:
            return None
        value = str(number)
    return value if not key.choices or value in key.choices else None
