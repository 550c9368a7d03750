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
        spot, found = field.type, found[name]
    dotted = ".".join(path)
    if not isinstance(_bare(spot), inspect.StructType):
        return _one_line(f"{dotted} must be {expectation(spot)}, found {_show(found)}")
    if not isinstance(found, Mapping):
        return _one_line(f"{dotted} must be a table of keys, found {_show(found)}")
    known = {f.encode_name: f for f in _fields(spot)}
    if unknown := [name for name in found if name not in known]:
        return _one_line(_unknown(model, path, unknown[0], list(known)))
    if missing := [f for name, f in known.items() if f.required and name not in found]:
        return _one_line(_missing(missing[0], path))
    return _one_line(f"{dotted}: {reason or said}")


def expectation(spot: inspect.Type) -> str:
    """What a value of this type may be, with unit and range, as the end of "must be ..."."""
    bare = _bare(spot)
    if isinstance(bare, inspect.LiteralType):
        return "one of " + ", ".join(_show(v) for v in bare.values) if len(bare.values) > 1 else _show(bare.values[0])
    if isinstance(bare, inspect.FloatType | inspect.IntType):
        kind = "a number" if isinstance(bare, inspect.FloatType) else "a whole number"
        unit = unit_of(spot)
        suffix = f" {unit}" if unit not in ("", "1", "port") else ""
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
    extra = spot.extra_json_schema if isinstance(spot, inspect.Metadata) else None
    return str((extra or {}).get("x-unit", ""))


def walk(model: type[Struct]) -> Iterator[tuple[str, inspect.Field]]:
    """Every key of the model with its dotted path, in file order."""
    yield from _walk(inspect.type_info(model), "")


def _walk(spot: inspect.Type, prefix: str) -> Iterator[tuple[str, inspect.Field]]:
    for field in _fields(spot):
        path = prefix + field.encode_name
        if isinstance(_bare(field.type), inspect.StructType):
            yield from _walk(field.type, path + ".")
        else:
            yield path, field


def _bare(spot: inspect.Type) -> inspect.Type:
    return spot.type if isinstance(spot, inspect.Metadata) else spot


def _fields(spot: inspect.Type) -> tuple[inspect.Field, ...]:
    bare = _bare(spot)
    return bare.fields if isinstance(bare, inspect.StructType) else ()


def _unknown(model: type[Struct], path: list[str], name: object, known: list[str]) -> str:
    text = str(name)
    dotted = ".".join([*path, text if re.fullmatch(r"[\w-]+", text) else json.dumps(text)])
    if near := difflib.get_close_matches(text, known, n=1):
        return f"{dotted} is not a known key; did you mean {'.'.join([*path, near[0]])}?"
    if elsewhere := [p for p, _ in walk(model) if p.rpartition(".")[2] == text]:
        return f"{dotted} is not a known key here; did you mean {elsewhere[0]}?"
    return f"{dotted} is not a known key; known here are {', '.join(known)}"


def _missing(field: inspect.Field, path: list[str]) -> str:
    dotted = ".".join([*path, field.encode_name])
    if isinstance(_bare(field.type), inspect.StructType):
        needs = [f.encode_name for f in _fields(field.type) if f.required]
        return f"the table [{dotted}] is missing" + (f"; it needs {', '.join(needs)}" if needs else "")
    return f"{dotted} is missing: it must be {expectation(field.type)}"


def _show(value: object) -> str:
    text = json.dumps(value, ensure_ascii=False) if isinstance(value, str | bool | int | float) else type(value).__name__
    text = {"NaN": "nan", "Infinity": "inf", "-Infinity": "-inf", "dict": "a table", "list": "a list"}.get(text, text)
    return text if len(text) <= 60 else text[:57] + "..."


def _one_line(text: str) -> str:
    return " ".join(text.split())
