"""The configuration of an AR.Drone: the keys of a 2.0, who may write them, the sets kept for each session, user and application.

Source: Parrot AR.Drone SDK 2.0 developer guide, chapter 8 (configuration, multi-configuration); key names and defaults as a
drone answers on port 5559.
"""

import csv
import math
import re
from collections.abc import Iterator, Mapping
from enum import Enum
from pathlib import Path
from typing import Literal, cast

from msgspec import Struct, structs

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


_ID_KEYS = {"custom:session_id": Scope.SESSION, "custom:profile_id": Scope.USER, "custom:application_id": Scope.APPLICATION}
_DESCRIPTION_KEYS = {
    Scope.APPLICATION: "custom:application_desc",
    Scope.USER: "custom:profile_desc",
    Scope.SESSION: "custom:session_desc",
}
_ID = re.compile(r"[0-9a-f]{8}")

_LIMITS = ("euler_angle_max", "control_vz_max", "control_yaw")
"""Keys with an indoor and an outdoor twin: control:outdoor says which one rules."""
LIMIT_KEYS = frozenset(f"control:{where}{name}" for where in ("", "indoor_", "outdoor_") for name in _LIMITS)


def tilting(keys: Mapping[str, Key], most_rad: float) -> Mapping[str, Key]:
    """Return the keys of a vehicle that takes tilts up to another one than the AR.Drone's firmware does."""
    return {name: structs.replace(key, high=most_rad) if name.endswith("euler_angle_max") else key for name, key in keys.items()}


def _table() -> Iterator[Key]:
    with Path(__file__).with_name("configuration.csv").open(encoding="ascii", newline="") as file:
        for row in csv.DictReader(file):
            scope, low, high = Scope(row["scope"]), float(row["low"] or -math.inf), float(row["high"] or math.inf)
            kind, choices = cast(Kind, row["kind"]), frozenset(row["choices"].split())
            yield Key(row["name"], row["default"], kind, scope, row["writable"] == "yes", low, high, choices)


KEYS: Mapping[str, Key] = {key.name: key for key in _table()}
"""The keys of a 2.0 with firmware 2.4.8. Which user and application a session flies with is part of the session."""


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
