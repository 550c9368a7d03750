"""Write the settings out: a TOML file with every key in it, a JSON Schema, and the reference page."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec
from msgspec import inspect

from companion.settings.expert import EXPERT, split
from companion.settings.model import Settings
from companion.settings.refusal import described, fields, unit_of, variants
from estimator.contracts.keys import PUBLIC


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


def schema() -> str:
    """Return the JSON Schema of the settings file; units and sources of defaults are under `x-unit` and `x-source`."""
    whole = msgspec.json.schema(Settings)
    tables = whole["$defs"]
    for name, table in [*tables.items()]:
        keys = table["properties"]
        inside = {key: _for_experts(node) for key, node in keys.items() if "$ref" in str(node) or not _public(node)}
        table["properties"] = {key: node for key, node in keys.items() if "$ref" in str(node) or _public(node)}
        tables[f"Expert{name}"] = {**table, "properties": inside, "required": []}
    tables["Settings"]["properties"][EXPERT] = {"$ref": "#/$defs/ExpertSettings"}
    return json.dumps(whole, indent=2, ensure_ascii=False) + "\n"


def _public(node: Mapping[str, Any]) -> bool:
    return PUBLIC in node or ("enum" in node and "description" not in node)


def _for_experts(node: Any) -> Any:
    """Return a reference to a table as one to what experts may set in it, without its default."""
    if isinstance(node, Mapping):
        left_out = ("default", "discriminator") if "$ref" in str(node) else ()
        return {key: _for_experts(value) for key, value in node.items() if key not in left_out}
    if isinstance(node, list):
        return [_for_experts(value) for value in node]
    return node.replace("#/$defs/", "#/$defs/Expert") if isinstance(node, str) else node


def reference(*, expert: bool = False) -> str:
    """Return the reference in Markdown: a table for each section of the file, or one table of the expert keys."""
    if expert:
        rows = [row for _, _, _, rows in _sections() for row in rows]
        return "\n".join(["# Expert keys", "", *_EXPERT_WORDS, "", *_HEADER, *rows]) + "\n"
    lines = [
        "# Configuration",
        "",
        "A rig has one TOML file. `decklander config check FILE` checks it, `config show FILE` prints it with each default",
        "filled in, and `config schema` prints a JSON Schema for editors. This page is the output of `config reference`.",
        "",
        "A key that is unknown, of the wrong type or out of range is refused. Where a default is missing the key must be given.",
    ]
    for heading, meaning, public, _ in _sections():
        if public:
            lines += ["", f"## {heading}", "", meaning, "", *_HEADER, *public]
    lines += ["", "## Expert keys", "", *_EXPERT_WORDS, "`decklander config reference --expert` prints all of them."]
    return "\n".join(lines) + "\n"


_EXPERT_WORDS = (
    "Expert keys describe sensors, filter, timing and limits of the product. Their defaults are right for almost everybody.",
    "They stand in the same tables under `[expert]`: `expert.guidance.cone.slope` is `slope` in `[expert.guidance.cone]`.",
)


def _sections() -> Iterator[tuple[str, str, list[str], list[str]]]:
    """Yield the heading, the meaning, the public rows and the expert rows of each table."""
    for path, struct in _structs(described(Settings), ()):
        here = [f for f in fields(struct) if not variants(f.type)]
        public = [f for f in here if _is_public(f, struct)]
        kind = f" with {struct.tag_field} = {value_text(struct.tag)}" if struct.tag_field else ""
        yield (
            f"[{'.'.join(path)}]{kind}",
            _meaning(struct),
            [_row(f.encode_name, f) for f in public],
            [_row(".".join((EXPERT, *path, f.encode_name)), f) for f in here if f not in public],
        )


_HEADER = ("| key | default | range | unit | meaning | source of the default |", "|---|---|---|---|---|---|")


def _is_public(field: inspect.Field, struct: inspect.StructType) -> bool:
    assert isinstance(field.type, inspect.Metadata)
    return field.encode_name == struct.tag_field or PUBLIC in (field.type.extra_json_schema or {})


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
