"""Generate pages about the settings: a JSON Schema and the reference page."""

from __future__ import annotations

import json
from collections.abc import Iterator

import msgspec
from msgspec import inspect

from companion.settings.model import Settings
from companion.settings.refusal import described, fields, unit_of, variants
from companion.settings.whole_file import value_text


def schema() -> str:
    """Return the JSON Schema of the settings file; units and sources of defaults are under `x-unit` and `x-source`."""
    return json.dumps(msgspec.json.schema(Settings), indent=2, ensure_ascii=False) + "\n"


def reference() -> str:
    """Return the reference page in Markdown, with one table for each section."""
    lines = [
        "# Configuration",
        "",
        "One TOML file a rig. `decklander config check FILE` says whether a file is good, `config show FILE` prints it with each",
        "default filled in, `config schema` gives a JSON Schema for editors. This page is the output of `config reference`.",
        "",
        "A key that is unknown, of the wrong type or out of range is refused, never guessed. Whole numbers are welcome where a",
        "number is asked for; text and truth values are not. Where a default is missing the key must be given.",
    ]
    for path, struct in _structs(described(Settings), ()):
        here = [f for f in fields(struct) if not variants(f.type)]
        kind = f" with {struct.tag_field} = {value_text(struct.tag)}" if struct.tag_field else ""
        lines += ["", f"## [{'.'.join(path)}]{kind}", "", _meaning(struct), ""]
        if here:
            lines += ["| key | default | range | unit | meaning | source of the default |", "|---|---|---|---|---|---|"]
            lines += [_row(f.encode_name, f) for f in here]
        else:
            lines.pop()
    return "\n".join(lines) + "\n"


def _meaning(struct: inspect.StructType) -> str:
    """Return the description of a table: the docstring of its class up to the errors that it raises."""
    return " ".join((struct.cls.__doc__ or "").partition("Raises:")[0].split())


def _row(name: str, field: inspect.Field) -> str:
    assert isinstance(field.type, inspect.Metadata)
    notes = field.type.extra_json_schema or {}
    default = "**required**" if field.required else f"`{value_text(field.default)}`"
    unit = unit_of(field.type)
    unit = "" if unit in ("1", "id") else unit
    cells = [
        f"`{name}`",
        default,
        _range(field.type.type),
        unit,
        notes["description"],
        notes.get("x-source", ""),
    ]
    return "| " + " | ".join(cells) + " |"


def _range(node: inspect.Type) -> str:
    if isinstance(node, inspect.LiteralType):
        return ", ".join(f"`{value_text(v)}`" for v in node.values)
    if isinstance(node, inspect.FloatType | inspect.IntType):
        return f"{node.ge:g} to {node.le:g}"
    if isinstance(node, inspect.BoolType):
        return "`true`, `false`"
    return "text"


def _structs(node: inspect.Type, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], inspect.StructType]]:
    for struct in variants(node):
        if path:
            yield path, struct
        for field in struct.fields:
            yield from _structs(field.type, (*path, field.encode_name))
