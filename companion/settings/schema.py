"""The model of the settings as data: explain a refused file, write settings and their reference out.

msgspec reports where the first fault of a file is. The expected value comes from the model and the found value from the data.
"""

import difflib
import json
import re
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import msgspec
from msgspec import Struct, inspect

from companion.settings.model import EXPERT, Settings, in_file, split
from estimator.contracts.address import guarded
from estimator.contracts.errors import BadInput, one_line
from estimator.contracts.keys import PAGE, PUBLIC


def explain(model: type[Struct], data: Mapping[str, Any], message: str) -> str:
    """Return one line about the fault that msgspec reports as `message` for `data` against `model`."""
    reason, _, place = message.rpartition(" - at `")
    path = re.findall(r"\w+", place) if reason else []
    node = described(model)
    found: Any = data
    for name in path:
        field = next((f for f in _fields(node) if f.encode_name == name), None)
        if field is None or not isinstance(found, Mapping) or name not in found:
            return one_line(message)
        node, found = _chosen(field.type, found[name]), found[name]
    dotted = ".".join(path)
    if not isinstance(_bare(node), inspect.StructType | inspect.UnionType):
        return one_line(f"{dotted} must be {expectation(node)}, found {_show(found)}")
    if not isinstance(found, Mapping):
        return one_line(f"{dotted} must be a table of keys, found {_show(found)}")
    known = {f.encode_name: f for f in _fields(node)}
    kinds = variants(node)
    if len(kinds) > 1 and (tag := kinds[0].tag_field) and tag not in found:
        return one_line(_missing(known[tag], path))
    if unknown := [name for name in found if name not in known]:
        return one_line(_unknown(model, path, unknown[0], list(known)))
    if missing := [f for name, f in known.items() if f.required and name not in found]:
        return one_line(_missing(missing[0], path))
    return one_line(f"{dotted}: {reason or message}" if dotted else message)


def expectation(node: inspect.Type) -> str:
    """Return what a value of this type may be, with unit and range, as the end of "must be ..."."""
    bare = _bare(node)
    if isinstance(bare, inspect.LiteralType):
        return "one of " + ", ".join(_show(v) for v in bare.values) if len(bare.values) > 1 else _show(bare.values[0])
    if isinstance(bare, inspect.FloatType | inspect.IntType):
        kind = "a number" if isinstance(bare, inspect.FloatType) else "a whole number"
        unit = unit_of(node)
        suffix = f" {unit}" if unit not in ("", "1", "port", "id") else ""
        return f"{kind} from {bare.ge:g} to {bare.le:g}{suffix}"
    if isinstance(bare, inspect.StrType) and bare.pattern:
        return f"a word of letters, digits, - and _, {bare.min_length} to {bare.max_length} characters"
    if isinstance(bare, inspect.StrType):
        return f"text of {bare.min_length} to {bare.max_length} characters"
    if isinstance(bare, inspect.BoolType):
        return "true or false"
    return type(bare).__name__.removesuffix("Type").lower()


def unit_of(node: inspect.Type) -> str:
    """Return the unit of a key: "1" for a plain ratio, "" for text and choices."""
    node = _given(node)
    extra = node.extra_json_schema if isinstance(node, inspect.Metadata) else None
    return str((extra or {}).get("x-unit", ""))


def walk(model: type[Struct], kind: str | None = None) -> Iterator[tuple[str, inspect.Field]]:
    """Yield every key of the model with its dotted path, in file order.

    Args:
        model: the struct to describe.
        kind: for tables whose keys depend on their `kind`, yield the keys of this one; None yields those of each.
    """
    yield from _walk(described(model), "", kind)


def on_page(kind: str | None = None) -> frozenset[str]:
    """Return the paths of the keys that may be changed from a browser, for one kind of vehicle as in `walk`."""
    return frozenset(path for path, field in walk(Settings, kind) if _noted(field, PAGE))


@cache
def described(model: type[Struct]) -> inspect.Type:
    """Return the model as msgspec describes it, once for each: it evaluates every annotation again each time."""
    return inspect.type_info(model)


def variants(node: inspect.Type) -> tuple[inspect.StructType, ...]:
    """Return the structs that a table may be: several if its keys depend on its `kind`, none if the type is not a table."""
    bare = _bare(node)
    if isinstance(bare, inspect.UnionType):
        return tuple(kind for kind in bare.types if isinstance(kind, inspect.StructType))
    return (bare,) if isinstance(bare, inspect.StructType) else ()


def fields(struct: inspect.StructType) -> tuple[inspect.Field, ...]:
    """Return the keys of a table; the tag that names its kind comes first."""
    return (_tag(struct.tag_field, struct.tag), *struct.fields) if struct.tag_field else struct.fields


def _walk(node: inspect.Type, prefix: str, kind: str | None) -> Iterator[tuple[str, inspect.Field]]:
    for field in (f for struct in variants(node) if kind in (None, struct.tag) or not struct.tag_field for f in fields(struct)):
        path = prefix + field.encode_name
        if variants(field.type):
            yield from _walk(field.type, path + ".", kind)
        else:
            yield path, field


def _tag(name: str, *values: str | int | None) -> inspect.Field:
    kind = inspect.LiteralType(tuple(v for v in values if v is not None))
    notes = {"description": "kind of this table, on which its other keys depend"}
    return inspect.Field(name, name, inspect.Metadata(kind, extra_json_schema=notes))


def _bare(node: inspect.Type) -> inspect.Type:
    """Return the type without its annotations."""
    node = _given(node)
    return node.type if isinstance(node, inspect.Metadata) else node


def _given(node: inspect.Type) -> inspect.Type:
    """Return the type that an optional value has when it is given."""
    kinds = [kind for kind in node.types if not isinstance(kind, inspect.NoneType)] if isinstance(node, inspect.UnionType) else []
    return kinds[0] if len(kinds) == 1 else node


def _chosen(node: inspect.Type, found: object) -> inspect.Type:
    """Return the variant that the data name, or the type itself if there is no choice or none was made."""
    kinds = variants(node)
    tag = found.get(kinds[0].tag_field) if kinds and kinds[0].tag_field and isinstance(found, Mapping) else None
    return next((kind for kind in kinds if kind.tag_field and kind.tag == tag), node)


def _fields(node: inspect.Type) -> tuple[inspect.Field, ...]:
    kinds = variants(node)
    if len(kinds) > 1 and kinds[0].tag_field:
        return (_tag(kinds[0].tag_field, *(kind.tag for kind in kinds)),)
    return fields(kinds[0]) if kinds else ()


def _unknown(model: type[Struct], path: list[str], name: object, known: list[str]) -> str:
    text = str(name)
    dotted = ".".join([*path, text if re.fullmatch(r"[\w-]+", text) else json.dumps(text)])
    if near := difflib.get_close_matches(text, known, n=1):
        return f"{dotted} is not a known key; did you mean {'.'.join([*path, near[0]])}?"
    if dotted in dict(walk(model)):
        return f"{dotted} is not a known key of this kind of {path[-1]}"
    if elsewhere := [p for p, _ in walk(model) if p.rpartition(".")[2] == text]:
        return f"{dotted} is not a known key here; did you mean {elsewhere[0]}?"
    return f"{dotted} is not a known key; known here are {', '.join(known)}"


def _missing(field: inspect.Field, path: list[str]) -> str:
    dotted = ".".join([*path, field.encode_name])
    if variants(field.type):
        needs = [f.encode_name for f in _fields(field.type) if f.required]
        return f"the table [{dotted}] is missing" + (f"; it needs {', '.join(needs)}" if needs else "")
    return f"{dotted} is missing: it must be {expectation(field.type)}"


def _show(value: object) -> str:
    value = str(guarded(value)) if isinstance(value, str) else value
    text = json.dumps(value, ensure_ascii=False) if isinstance(value, str | bool | int | float) else type(value).__name__
    text = {"NaN": "nan", "Infinity": "inf", "-Infinity": "-inf", "dict": "a table", "list": "a list"}.get(text, text)
    return text if len(text) <= 60 else text[:57] + "..."


def toml(settings: Settings) -> str:
    """Return a settings file with every key in it, defaults included; reading it gives the same settings.

    Passwords in addresses are masked: such a file is shown, recorded and sent to others.
    """
    return "\n".join(_tables(split(msgspec.to_builtins(settings, enc_hook=str), type(settings)), ())).lstrip("\n") + "\n"


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
        return "\n".join(["# Expert keys", "", *_EXPERT_WORDS, "", *_table(rows)]) + "\n"
    lines = [
        "# Configuration",
        "",
        "A rig has one TOML file. `decklander config check FILE` checks it, `config show FILE` prints it with each default",
        "filled in, and `config schema` prints a JSON Schema for editors. This page is the output of `config reference`.",
        "",
        "A key that is unknown, of the wrong type or out of range is refused. A path is absolute, or relative to the settings",
        'file unless its key says otherwise; "credential:NAME" is a systemd credential.',
        "",
        '"page": the key may be changed from the operator page (docs/page.md), and no other may.',
    ]
    first: dict[tuple[str, str], str] = {}
    for heading, meaning, public, _ in _sections():
        for row in public:
            if (where := first.setdefault((row[0], row[_MEANING]), heading)).split()[0] != heading.split()[0]:
                row[_MEANING] = f"as in {where}"
        lines += ["", f"## {heading}", "", meaning, "", *_table(public)] if public else []
    lines += ["", "## Expert keys", "", *_EXPERT_WORDS, "`decklander config reference --expert` prints all of them."]
    return "\n".join(lines) + "\n"


def looked_up(word: str) -> str:
    """Return what is known of each key whose path in a file contains a word: default, range, unit and meaning.

    Raises:
        BadInput: there is no such key.
    """
    out = {}
    for path, field in walk(Settings):
        assert isinstance(field.type, inspect.Metadata)
        name, unit = in_file(path), unit_of(field.type)
        if word in name:
            default = "must be given" if field.required else value_text(field.default)
            given = f"{_range(field.type.type)}{'' if unit in ('1', 'id', '') else ' ' + unit}".replace("`", "")
            out[name] = f"{name} = {default}    ({given})\n    {(field.type.extra_json_schema or {})['description']}\n"
    if not out:
        raise BadInput(f"no key of the settings contains {word!r}")
    return "".join(out.values())


_EXPERT_WORDS = (
    "Expert keys describe sensors, filter, timing and limits of the product. Their defaults are right for almost everybody.",
    "They stand in the same tables under `[expert]`: `expert.guidance.cone.slope` is `slope` in `[expert.guidance.cone]`.",
)


def _sections() -> Iterator[tuple[str, str, list[list[str]], list[list[str]]]]:
    """Yield the heading, the meaning, the public rows and the expert rows of each table."""
    for path, struct in _structs(described(Settings), ()):
        here = [f for f in fields(struct) if not variants(f.type)]
        public = [f for f in here if _is_public(f, struct)]
        kind = f" with {struct.tag_field} = {value_text(struct.tag)}" if struct.tag_field else ""
        yield (
            f"[{'.'.join(path)}]{kind}",
            " ".join((struct.cls.__doc__ or "").partition("Raises:")[0].split()),
            [_row(f.encode_name, f) for f in public],
            [_row(".".join((EXPERT, *path, f.encode_name)), f) for f in here if f not in public],
        )


_COLUMNS = ["key", "default", "range", "unit", "page", "meaning", "source of the default"]

_MEANING = _COLUMNS.index("meaning")


def _table(rows: list[list[str]]) -> list[str]:
    """Return the lines of a table, without columns that are empty."""
    kept = [n for n in range(len(_COLUMNS)) if any(row[n] for row in rows)]
    return ["| " + " | ".join(row[n] for n in kept) + " |" for row in (_COLUMNS, ["---"] * len(_COLUMNS), *rows)]


def _is_public(field: inspect.Field, struct: inspect.StructType) -> bool:
    return field.encode_name == struct.tag_field or _noted(field, PUBLIC)


def _noted(field: inspect.Field, note: str) -> bool:
    assert isinstance(field.type, inspect.Metadata)
    return note in (field.type.extra_json_schema or {})


def _row(name: str, field: inspect.Field) -> list[str]:
    assert isinstance(field.type, inspect.Metadata)
    notes, unit = field.type.extra_json_schema or {}, unit_of(field.type)
    default = "**required**" if field.required else f"`{value_text(field.default)}`"
    range_ = "" if isinstance(field.type.type, inspect.BoolType) else _range(field.type.type)
    shown, page = "" if unit in ("1", "id") else unit, "yes" if PAGE in notes else ""
    return [f"`{name}`", default, range_, shown, page, notes["description"], notes.get("x-source", "")]


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
