"""Overrides: single keys of a scenario or of the settings that get another value, as in `wind.speed_m_s=4`, or several."""

import copy
import itertools
import math
from collections.abc import Sequence
from typing import Any

from msgspec import Struct

from companion.settings.load import from_mapping as settings_from_mapping
from companion.settings.model import EXPERT, Settings
from companion.settings.overrides import NOTHING, Value, finite, key_and_text, leaf, leaves, nearest, plain, put, value_like
from estimator.contracts.errors import BadInput
from sitl.flight.one_flight import following
from sitl.scenario.scenario import Scenario
from sitl.scenario.scenario import from_mapping as scenario_from_mapping

Override = tuple[str, Value]
Point = tuple[Override, ...]
"""The varied keys of a flight with their values; empty where nothing is varied."""
_FORCED = "settings."
"""Prefix that reaches a key of the settings which the scenario has too."""
_SHARED = ("camera.file", "pad.file")
"""Keys of the scenario that the settings follow."""


class Overridable:
    """A scenario and settings whose single keys can be given other values.

    A key is looked for in the scenario first, then in the settings; `settings.` before it skips the scenario. An item of a list
    has its number for a key, as in `faults.0.speed_m_s`. The scenario's camera and pad are also those of the settings, unless
    `settings.camera.file` or `settings.pad.file` is given too; and settings that follow the scenario in all that
    `sitl.flight.one_flight.following` names go on following it. The methods' argument `where` begins their errors, as in
    `--vary`.

    Args:
        by_autopilot: as of `settings_for`, which made the settings.
    """

    def __init__(self, scenario: Scenario, settings: Settings, *, by_autopilot: bool = False) -> None:
        self.scenario, self.settings, self._by_autopilot = scenario, settings, by_autopilot
        self._tables: tuple[dict[str, Any], dict[str, Any]] = (plain(scenario), plain(settings))

    def value(self, key: str, text: str, where: str) -> Value:
        """Return the value that a text means for a key, by the type of the key's present value.

        Raises:
            BadInput: the key does not exist, or holds numbers and the text is none.
        """
        return value_like(self._find(key, where), text, key, where)

    def parse(self, text: str, where: str) -> Override:
        """Return the override that `KEY=VALUE` means.

        Raises:
            BadInput: it has another form, or as `value`.
        """
        key, value = key_and_text(text, where, "wind.speed_m_s=4")
        return key, self.value(key, value, where)

    def with_values(self, overrides: Sequence[Override], where: str) -> tuple[Scenario, Settings]:
        """Return the scenario and the settings with these values.

        Raises:
            BadInput: a key is unknown, or a value has the wrong type, is out of range or contradicts another.
        """
        if not overrides:
            return self.scenario, self.settings
        tables = copy.deepcopy(self._tables)
        placed: tuple[list[tuple[list[str], Value]], ...] = ([], [])
        for key, value in overrides:
            self._find(key, where)
            which, path = self._place(key)
            placed[which].append((path, value))
        for path, value in placed[0]:
            put(tables[0], path, value)
        scenario = scenario_from_mapping(tables[0], where) if placed[0] else self.scenario
        settings = self.settings
        if placed[0] and following(self.scenario, settings, by_autopilot=self._by_autopilot) == settings:
            settings = following(scenario, settings, by_autopilot=self._by_autopilot)
            tables = tables[0], plain(settings)
        else:
            placed[1][:0] = [(path, value) for path, value in placed[0] if ".".join(path) in _SHARED]
        if placed[1]:
            for path, value in placed[1]:
                put(tables[1], path, value)
            settings = settings_from_mapping(tables[1], where)
            if fault := settings.fault():
                raise BadInput(f"{where}: {fault}")
        return scenario, settings

    def _place(self, key: str) -> tuple[int, list[str]]:
        if key.startswith(_FORCED):
            return 1, key.removeprefix(_FORCED).split(".")
        path = key.removeprefix(f"{EXPERT}.").split(".")
        return (0 if leaf(self._tables[0], path) is not NOTHING else 1), path

    def _find(self, key: str, where: str) -> Any:
        which, path = self._place(key)
        found = leaf(self._tables[which], path)
        if found is NOTHING:
            known = [*leaves(self._tables[0]), *leaves(self._tables[1])]
            hint = nearest(key.removeprefix(_FORCED), known) or "keys are written as in wind.speed_m_s or guidance.rate_hz"
            raise BadInput(f"{where}: neither scenario nor settings have a key {key!r}; {hint}")
        return found


POINTS_MAX = 1_000_000
_DIGITS = 9
"""Significant digits of a value, as a command line shows them: enough for any key, and short enough to read."""


class Axis(Struct, frozen=True):
    """One varied key with its values."""

    key: str
    text: str
    """Text as the person wrote it."""
    values: tuple[Value, ...]


def parse_axis(text: str, given: Overridable, where: str) -> Axis:
    """Return the axis that `KEY=LOW:HIGH:STEP` or `KEY=A,B,C` means.

    Raises:
        BadInput: it has another form, or the key is unknown.
    """
    key, equals, span = text.partition("=")
    if not equals or not span:
        raise BadInput(f"{where} {text!r}: write KEY=LOW:HIGH:STEP or KEY=A,B,C, as in wind.speed_m_s=0:10:2")
    if ":" not in span:
        return Axis(key, text, tuple(given.value(key, item, where) for item in span.split(",")))
    parts = span.split(":")
    if len(parts) != 3:
        raise BadInput(f"{where} {text!r}: a range is LOW:HIGH:STEP")
    present = given.value(key, parts[0], where)
    if isinstance(present, bool | str):
        raise BadInput(f"{where} {text!r}: {key} holds no number; list its values, as in {key}=A,B")
    low, high, step = (finite(part, f"{where}: {key}") for part in parts)
    if step == 0.0 or (high - low) / step < 0.0:
        raise BadInput(f"{where} {text!r}: steps of {step:g} do not lead from {low:g} to {high:g}")
    count = math.floor((high - low) / step * (1.0 + 1e-9)) + 1
    if count > POINTS_MAX:
        raise BadInput(f"{where} {text!r}: {count} values are more than {POINTS_MAX}")
    whole = type(given._find(key, where)) is int
    steps = [float(f"{low + n * step:.{_DIGITS}g}") for n in range(count)]
    return Axis(key, text, tuple(int(v) if whole and v == int(v) else v for v in steps))


def factorial(axes: Sequence[Axis]) -> list[Point]:
    """Return all combinations of the axes' values; a single empty point without axes.

    Raises:
        BadInput: a key is varied twice, or there are too many combinations.
    """
    keys = [axis.key for axis in axes]
    for key in keys:
        if keys.count(key) > 1:
            raise BadInput(f"--vary: {key} is given twice")
    if (count := math.prod(len(axis.values) for axis in axes)) > POINTS_MAX:
        raise BadInput(f"--vary: {count} combinations are more than {POINTS_MAX}")
    return [
        tuple((axis.key, value) for axis, value in zip(axes, values, strict=True))
        for values in itertools.product(*(axis.values for axis in axes))
    ]


def described(kind: str, axes: Sequence[Axis]) -> dict[str, Any]:
    """Return a design as plain values, for the manifest."""
    return {"kind": kind, "axes": [axis.text for axis in axes], "keys": [axis.key for axis in axes]}
