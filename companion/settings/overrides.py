"""Overrides: single keys of the settings that get another value, as in `guidance.rate_hz=40`."""

import difflib
import math
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import msgspec

from companion.settings.capabilities import require_key
from companion.settings.load import from_mapping
from companion.settings.model import EXPERT, Settings
from companion.settings.remarks import without_effect
from estimator.contracts.errors import BadInput

Value = bool | int | float | str
NOTHING = object()
_NUMBER = "+-.0123456789eE"


def with_overrides(settings: Settings, texts: Sequence[str], where: str) -> Settings:
    """Return the settings in which the keys of `KEY=VALUE` texts have these values, with or without `expert.` before them.

    Args:
        where: the option that the texts were given with, which begins the errors.

    Raises:
        BadInput: a text has another form, a key is unknown, or a value has the wrong type, is out of range or contradicts
            another.
    """
    if not texts:
        return settings
    tables = plain(settings)
    for text in texts:
        key, value = key_and_text(text, where, "estimator.history_s=1")
        present = leaf(tables, key.split("."))
        if present is NOTHING:
            require_key(key, f"{where}: {key}")
            hint = nearest(key, [*dict(leaves(tables))]) or "keys are written as in guidance.rate_hz"
            raise BadInput(f"{where}: the settings have no key {key!r}; {hint}")
        put(tables, key.split("."), value_like(present, value, key, where))
    changed = from_mapping(tables, where)
    changed.refuse_faults(where, settings)
    return changed


def key_and_text(text: str, where: str, example: str) -> tuple[str, str]:
    """Return the key and the value's text of `KEY=VALUE`; the key without `expert.` before it.

    Raises:
        BadInput: it has another form.
    """
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise BadInput(f"{where} {text!r}: write KEY=VALUE, as in {example}")
    return key.removeprefix(f"{EXPERT}."), value


def value_like(present: Any, text: str, key: str, where: str) -> Value:
    """Return the value that a text means, by the type of the key's present value; by its own form where there is none.

    Raises:
        BadInput: the key is true or false, or holds numbers, and the text is none of these.
    """
    if isinstance(present, bool | None) and text in ("true", "false"):
        return text == "true"
    if isinstance(present, bool):
        raise BadInput(f"{where}: {key} is true or false, found {text!r}")
    if isinstance(present, str) or (present is None and text.strip(_NUMBER)):
        return text
    number = finite(text, f"{where}: {key}")
    return number if isinstance(present, float) or number != int(number) else int(number)


def finite(text: str, where: str) -> float:
    """Return the number that a text means.

    Raises:
        BadInput: it is no finite number.
    """
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise BadInput(f"{where} needs a number, found {text!r}")
    return number


def nearest(key: str, known: Sequence[str]) -> str | None:
    """Return a question for the known key that is most like this one; None if none is."""
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
    return f"did you mean {near[0]!r}?" if near else None


def plain(model: msgspec.Struct) -> dict[str, Any]:
    """Return settings or a scenario as tables of plain values, with lists that can be changed."""
    out: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(model))
    return out


def leaf(table: Any, path: Sequence[str]) -> Any:
    """Return the single value at a path, or `NOTHING` where there is none or a whole table."""
    for name in path:
        if isinstance(table, dict) and name in table:
            table = table[name]
        elif isinstance(table, list) and name.isdecimal() and int(name) < len(table):
            table = table[int(name)]
        else:
            return NOTHING
    return NOTHING if isinstance(table, dict | list) else table


def leaves(table: Any, above: str = "") -> Iterator[tuple[str, Value]]:
    """Yield every single value with its key; an item of a list has its number for a name."""
    named = table.items() if isinstance(table, dict) else enumerate(table)
    for name, value in named:
        if isinstance(value, dict | list):
            yield from leaves(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


def put(table: Any, path: Sequence[str], value: Value) -> None:
    """Give the key at a path, which exists, this value."""
    for name in path[:-1]:
        table = table[_index(table, name)]
    table[_index(table, path[-1])] = value


def _index(table: Any, name: str) -> str | int:
    return int(name) if isinstance(table, list) else name


_LINKS = r"(bridge|http|mqtt|recorder|video_stream)\."
_IDLE_IN = {
    "a replay": rf"{_LINKS}|(rtk|service)\.|camera\.(?!file|gimbal\.)|operator\.(?!manual\.)|vehicle\.(host|links)",
    "a replay without --mavlink": r"landing_target\.",
    "a simulated flight": rf"{_LINKS}|(landing_target|service)\.|operator\.(?!manual\.)|vehicle\.host",
    "a flight with an autopilot": _LINKS,
    "a replay that searches no frames": r"vision\.|camera\.(?!file)",
    "a flight by --perception truth": r"estimator\.",
    "a flight without frames, as by --perception model": (
        r"(drops|lamps|video)\.|light\.(?!exposure_ev)|camera\.(blur|exposure_l|full|read|white)"
    ),
}
"""Patterns of the keys of settings and scenarios that nothing reads there."""


def warn_of_idle(points: Sequence[Settings], given: Sequence[str], places: Mapping[str, bool]) -> None:
    """Name on standard error the keys of the `KEY=VALUE` given that cannot act where this is, or by any of these settings."""
    keys = [text.partition("=")[0].removeprefix("settings.").removeprefix(f"{EXPERT}.") for text in given]
    for place in (place for place, there in places.items() if there):
        if idle := [key for key in keys if re.match(_IDLE_IN[place], key)]:
            sys.stderr.write(f"decklander: {', '.join(idle)}: without effect in {place}\n")
    found = [line for settings in points for line in without_effect(settings)]
    for line, number in {line: found.count(line) for line in found}.items():
        sys.stderr.write(f"decklander: {line}{f' ({number} of {len(points)} points)' if len(points) > 1 else ''}\n")
