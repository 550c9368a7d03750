"""Write settings as a TOML file with every key in it."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from companion.settings.expert import split
from companion.settings.model import Settings


def toml(settings: Settings) -> str:
    """Return a settings file with every key in it, defaults included; reading it gives the same settings."""
    return "\n".join(_tables(split(msgspec.to_builtins(settings)), ())).lstrip("\n") + "\n"


def _tables(data: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[str]:
    plain = {k: v for k, v in data.items() if not isinstance(v, Mapping)}
    if plain:
        yield f"\n[{'.'.join(path)}]"
        yield from (f"{k} = {value_text(v)}" for k, v in plain.items())
    for k, v in data.items():
        if isinstance(v, Mapping):
            yield from _tables(v, (*path, k))


def value_text(value: object) -> str:
    """Return a value of a key as TOML has it."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value)
