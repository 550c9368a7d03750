"""Overrides: single keys of a scenario or of the settings that get another value, as in `wind.speed_m_s=4`."""

from __future__ import annotations

import copy
import difflib
import math
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

from companion.config.model import Settings
from companion.config.settings import from_mapping as settings_from_mapping
from estimator.contracts.errors import BadInput
from sitl.one_flight import following
from sitl.scenario import Scenario
from sitl.scenario import from_mapping as scenario_from_mapping

Value = bool | int | float | str
Override = tuple[str, Value]
_FORCED = "settings."
"""Prefix that reaches a key of the settings which the scenario has too."""
_SHARED = ("camera.file", "pad.file")
"""Keys of the scenario that the settings follow."""


class Overridable:
    """A scenario and settings of which single keys can be given other values.

    A key is looked for in the scenario first, then in the settings; `settings.` before it skips the scenario. An item of a list
    has its number for a key, as in `faults.0.speed_m_s`. The scenario's camera and pad are also those of the settings, unless
    `settings.camera.file` or `settings.pad.file` is given too; and settings that follow the scenario in all that
    `sitl.one_flight.following` names go on following it. The methods' argument `where` begins their errors, as in `--vary`.
    """

    def __init__(self, scenario: Scenario, settings: Settings) -> None:
        self._scenario, self._settings = scenario, settings
        self._tables: tuple[dict[str, Any], dict[str, Any]] = (plain(scenario), plain(settings))

    def holds_whole_number(self, key: str, where: str) -> bool:
        """Return whether a key holds a whole number.

        Raises:
            BadInput: the key does not exist.
        """
        present = self._find(key, where)
        return isinstance(present, int) and not isinstance(present, bool)

    def value(self, key: str, text: str, where: str) -> Value:
        """Return the value that a text means for a key, by the type of the key's present value.

        Raises:
            BadInput: the key does not exist, or holds numbers and the text is none.
        """
        present = self._find(key, where)
        if isinstance(present, bool):
            if text in ("true", "false"):
                return text == "true"
            raise BadInput(f"{where}: {key} is true or false, found {text!r}")
        if isinstance(present, str):
            return text
        number = finite(text, f"{where}: {key}")
        if isinstance(present, int) and number == int(number):
            return int(number)
        return number

    def parse(self, text: str, where: str) -> Override:
        """Return the override that `KEY=VALUE` means.

        Raises:
            BadInput: it has another form, or as `value`.
        """
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise BadInput(f"{where} {text!r}: write KEY=VALUE, as in wind.speed_m_s=4")
        return key, self.value(key, value, where)

    def with_values(self, overrides: Sequence[Override], where: str) -> tuple[Scenario, Settings]:
        """Return the scenario and the settings with these values.

        Raises:
            BadInput: a key is unknown, or a value has the wrong type, is out of range or contradicts another.
        """
        if not overrides:
            return self._scenario, self._settings
        tables = copy.deepcopy(self._tables)
        placed: tuple[list[tuple[list[str], Value]], ...] = ([], [])
        for key, value in overrides:
            self._find(key, where)
            which, path = self._place(key)
            placed[which].append((path, value))
        _put(placed[0], tables[0])
        scenario = scenario_from_mapping(tables[0], where) if placed[0] else self._scenario
        settings = self._settings
        if placed[0] and following(self._scenario, settings) == settings:
            settings = following(scenario, settings)
            tables = tables[0], plain(settings)
        else:
            placed[1][:0] = [(path, value) for path, value in placed[0] if ".".join(path) in _SHARED]
        if placed[1]:
            _put(placed[1], tables[1])
            settings = settings_from_mapping(tables[1], where)
            if fault := settings.fault():
                raise BadInput(f"{where}: {fault}")
        return scenario, settings

    def _place(self, key: str) -> tuple[int, list[str]]:
        if key.startswith(_FORCED):
            return 1, key.removeprefix(_FORCED).split(".")
        path = key.split(".")
        return (0 if _leaf(self._tables[0], path) is not _NOTHING else 1), path

    def _find(self, key: str, where: str) -> Any:
        which, path = self._place(key)
        found = _leaf(self._tables[which], path)
        if found is _NOTHING:
            known = [*_leaves(self._tables[0]), *_leaves(self._tables[1])]
            near = difflib.get_close_matches(key.removeprefix(_FORCED), known, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]!r}?" if near else "keys are written as in wind.speed_m_s or guidance.rate_hz"
            raise BadInput(f"{where}: neither scenario nor settings have a key {key!r}; {hint}")
        return found


_NOTHING = object()


def _put(values: Sequence[tuple[list[str], Value]], into: dict[str, Any]) -> None:
    for path, value in values:
        table: Any = into
        for name in path[:-1]:
            table = table[_index(table, name)]
        table[_index(table, path[-1])] = value


def plain(settings: Scenario | Settings) -> dict[str, Any]:
    """Return a scenario or settings as tables of plain values, with lists that can be changed."""
    out: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(settings))
    return out


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


def _index(table: Any, name: str) -> str | int:
    return int(name) if isinstance(table, list) else name


def _leaf(table: Any, path: Sequence[str]) -> Any:
    """Return the single value at a path, or `_NOTHING` where there is none or a whole table."""
    for name in path:
        if isinstance(table, dict) and name in table:
            table = table[name]
        elif isinstance(table, list) and name.isdecimal() and int(name) < len(table):
            table = table[int(name)]
        else:
            return _NOTHING
    return _NOTHING if isinstance(table, dict | list) else table


def _leaves(table: Any, above: str = "") -> Iterator[str]:
    named = table.items() if isinstance(table, dict) else enumerate(table)
    for name, value in named:
        if isinstance(value, dict | list):
            yield from _leaves(value, f"{above}{name}.")
        else:
            yield f"{above}{name}"
