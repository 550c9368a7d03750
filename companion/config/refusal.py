"""Why a settings file was refused, in one line a person can act on: the key's path, its unit and range, and what was found.

msgspec says where the first fault is; what was expected there is read from the model, and what was found from the data.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from msgspec import Struct, inspect


def explain(model: type[Struct], data: Mapping[str, Any], said: str) -> str:
    """One line about the fault that msgspec reports as `said` for `data` against `model`."""
    reason, _, place = said.rpartition(" - at `")
    path = re.findall(r"\w+", place) if reason else []
    spot: inspect.Type = inspect.type_info(model)
    found: Any = data
    for name in path:
        field = next((f for f in _fields(spot) if f.encode_name == name), None)
        if field is None or not isinstance(found, Mapping) or name not in found:
            return _one_line(said)
        spot, found = _chosen(field.type, found[name]), found[name]
    dotted = ".".join(path)
    if not isinstance(_bare(spot), inspect.StructType | inspect.UnionType):
        return _one_line(f"{dotted} must be {expectation(spot)}, found {_show(found)}")
    if not isinstance(found, Mapping):
        return _one_line(f"{dotted} must be a table of keys, found {_show(found)}")
    known = {f.encode_name: f for f in _fields(spot)}
    kinds = variants(spot)
    if len(kinds) > 1 and (tag := kinds[0].tag_field) and tag not in found:
        return _one_line(_missing(known[tag], path))
    if unknown := [name for name in found if name not in known]:
        return _one_line(_unknown(model, path, unknown[0], list(known)))
    if missing := [f for name, f in known.items() if f.required and name not in found]:
        return _one_line(_missing(missing[0], path))
    return _one_line(f"{dotted}: {reason or said}" if dotted else said)


def expectation(spot: inspect.Type) -> str:
    """What a value of this type may be, with unit and range, as the end of "must be ..."."""
    bare = _bare(spot)
    if isinstance(bare, inspect.LiteralType):
        return "one of " + ", ".join(_show(v) for v in bare.values) if len(bare.values) > 1 else _show(bare.values[0])
    if isinstance(bare, inspect.FloatType | inspect.IntType):
        kind = "a number" if isinstance(bare, inspect.FloatType) else "a whole number"
        unit = unit_of(spot)
        suffix = f" {unit}" if unit not in ("", "1", "port", "id") else ""
        return f"{kind} from {bare.ge:g} to {bare.le:g}{suffix}"
    if isinstance(bare, inspect.StrType) and bare.pattern:
        return f"a word of letters, digits, - and _, {bare.min_length} to {bare.max_length} characters"
    if isinstance(bare, inspect.StrType):
        return f"text of {bare.min_length} to {bare.max_length} characters"
    if isinstance(bare, inspect.BoolType):
        return "true or false"
    return type(bare).__name__.removesuffix("Type").lower()


def unit_of(spot: inspect.Type) -> str:
    """The unit of a key, "1" for a plain ratio, "" for text and choices."""
    spot = _given(spot)
    extra = spot.extra_json_schema if isinstance(spot, inspect.Metadata) else None
    return str((extra or {}).get("x-unit", ""))


def walk(model: type[Struct], kind: str | None = None) -> Iterator[tuple[str, inspect.Field]]:
    """Every key of the model with its dotted path, in file order.

    Args:
        kind: of the tables whose keys depend on their `kind`, show those of this one; None shows those of each.
    """
    yield from _walk(inspect.type_info(model), "", kind)


def variants(spot: inspect.Type) -> tuple[inspect.StructType, ...]:
    """The structs that a table may be: several where its keys depend on its `kind`, none where the spot is no table."""
    bare = _bare(spot)
    if isinstance(bare, inspect.UnionType):
        return tuple(kind for kind in bare.types if isinstance(kind, inspect.StructType))
    return (bare,) if isinstance(bare, inspect.StructType) else ()


def fields(struct: inspect.StructType) -> tuple[inspect.Field, ...]:
    """The keys of a table; the tag that says which kind it is comes first."""
    return (_tag(struct.tag_field, struct.tag), *struct.fields) if struct.tag_field else struct.fields


def _walk(spot: inspect.Type, prefix: str, kind: str | None) -> Iterator[tuple[str, inspect.Field]]:
    for field in (f for struct in variants(spot) if kind in (None, struct.tag) or not struct.tag_field for f in fields(struct)):
        path = prefix + field.encode_name
        if variants(field.type):
            yield from _walk(field.type, path + ".", kind)
        else:
            yield path, field


def _tag(name: str, *values: str | int | None) -> inspect.Field:
    kind = inspect.LiteralType(tuple(v for v in values if v is not None))
    notes = {"description": "what kind this is; the other keys depend on it"}
    return inspect.Field(name, name, inspect.Metadata(kind, extra_json_schema=notes))


def _bare(spot: inspect.Type) -> inspect.Type:
    """The type without its notes."""
    spot = _given(spot)
    return spot.type if isinstance(spot, inspect.Metadata) else spot


def _given(spot: inspect.Type) -> inspect.Type:
    """Return the type that an optional value has when it is given."""
    kinds = [kind for kind in spot.types if not isinstance(kind, inspect.NoneType)] if isinstance(spot, inspect.UnionType) else []
    return kinds[0] if len(kinds) == 1 else spot


def _chosen(spot: inspect.Type, found: object) -> inspect.Type:
    """The variant that the data say they are; the spot itself where there is no choice, or none was made."""
    kinds = variants(spot)
    said = found.get(kinds[0].tag_field) if kinds and kinds[0].tag_field and isinstance(found, Mapping) else None
    return next((kind for kind in kinds if kind.tag_field and kind.tag == said), spot)


def _fields(spot: inspect.Type) -> tuple[inspect.Field, ...]:
    kinds = variants(spot)
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
    text = json.dumps(value, ensure_ascii=False) if isinstance(value, str | bool | int | float) else type(value).__name__
    text = {"NaN": "nan", "Infinity": "inf", "-Infinity": "-inf", "dict": "a table", "list": "a list"}.get(text, text)
    return text if len(text) <= 60 else text[:57] + "..."


def _one_line(text: str) -> str:
    return " ".join(text.split())
