"""Read the mapping of a gamepad: a shipped one, or a file."""

from collections.abc import Iterator
from pathlib import Path

import msgspec

from companion.parts.gamepad.options import GamepadOperator
from companion.settings.capabilities import Reference
from companion.settings.load import find_file, read_toml
from companion.settings.model import Settings
from companion.settings.schema import explain
from drivers.gamepad.mapping import GamepadMapping
from estimator.contracts.errors import BadInput


def mapping_of(name_or_path: str) -> GamepadMapping:
    """Return the mapping in a file, or a shipped one (`configs/gamepads/*.toml`) by its name.

    Raises:
        BadInput: the file is missing or has a fault; the text names the file and the key.
    """
    path = find_file(name_or_path, "gamepads", Path(), "operator.gamepad")
    data = read_toml(path)
    try:
        return msgspec.convert(data, GamepadMapping, strict=True)
    except msgspec.ValidationError as why:
        raise BadInput(f"{path}: {explain(GamepadMapping, data, str(why))}") from why


def references(settings: Settings) -> Iterator[Reference]:
    """Yield the mapping that the settings name."""
    name = settings.of(GamepadOperator).gamepad
    yield "operator.gamepad", (name,), lambda: mapping_of(name)
