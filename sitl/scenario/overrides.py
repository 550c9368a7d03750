"""Single keys of a scenario and its settings with other values (`wind.from_deg=4`)."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

from companion.settings.capabilities import require_key
from companion.settings.load import from_mapping as settings_from_mapping
from companion.settings.model import EXPERT, Settings
from companion.settings.overrides import NOTHING, Value, key_and_text, leaf, leaves, nearest, plain, put, value_like
from estimator.contracts.errors import BadInput
from sitl.scenario.scenario import Scenario, refuse_idle, replaced
from sitl.scenario.scenario import from_mapping as scenario_from_mapping
from sitl.scenario.settings import following, in_world

Override = tuple[str, Value]
_FORCED = "settings."
"""Prefix that reaches a key of the settings which the scenario has too."""
_SHARED = ("camera.file", "pad.file")
"""Keys of the scenario that the settings follow."""


class Overridable:
    """A scenario and settings whose single keys can be given other values.

    A key is looked for in the scenario first, then in the settings; `settings.` before it skips the scenario. An item of a list
    has its number for a key, as in `faults.0.speed_m_s`. The scenario's camera and pad are also those of the settings, unless
    `settings.camera.file` or `settings.pad.file` is given too; and settings that follow the scenario in all that
    `sitl.scenario.settings.following` names go on following it. The methods' argument `where` begins their errors, as in
    `--vary`.

    Args:
        own: whether the settings are a person's own, which follow by `in_world` there.
        replaced: keys of them that have another value in the world.
    """

    def __init__(self, scenario: Scenario, settings: Settings, *, own: bool = False, replaced: Sequence[str] = ()) -> None:
        self.scenario, self.settings, self.replaced = scenario, settings, replaced
        self._follow = in_world if own else following
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
            for name in replaced(path[0], [there[1] for there, _ in placed[0] if there[0] == path[0] and there[1:]]):
                tables[0][path[0]].pop(name, None)
        scenario = scenario_from_mapping(tables[0], where) if placed[0] else self.scenario
        refuse_idle([".".join(path) for path, _ in placed[0]], scenario, where)
        settings = self.settings
        if placed[0] and self._follow(self.scenario, settings) == settings:
            settings = self._follow(scenario, settings)
            tables = tables[0], plain(settings)
        else:
            placed[1][:0] = [(path, value) for path, value in placed[0] if ".".join(path) in _SHARED]
        if placed[1]:
            for path, value in placed[1]:
                put(tables[1], path, value)
            settings = settings_from_mapping(tables[1], where)
            settings.refuse_faults(where, self.settings)
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
            require_key(".".join(path), f"{where}: {key}")
            known = [key for table in self._tables for key, _ in leaves(table)]
            hint = nearest(key.removeprefix(_FORCED), known) or "keys are written as in wind.speed_m_s or guidance.rate_hz"
            raise BadInput(f"{where}: neither scenario nor settings have a key {key!r}; {hint}")
        return found
