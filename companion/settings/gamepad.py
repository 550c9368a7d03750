"""Read a gamepad's mapping file."""

from pathlib import Path

import msgspec

from companion.settings.load import find_file, read_toml
from companion.settings.refusal import explain
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
