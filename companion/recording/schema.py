"""Make the JSON Schema of a record, in the subset of the language that viewers of MCAP files read.

Foxglove and Lichtblick know objects, arrays, numbers, integers, booleans, text and base64; no references, unions or
nulls. A field that may be None is therefore left out of the message where it is None, and out of `required`.
"""

from typing import Any

import msgspec
from msgspec import inspect


def json_schema(kind: type[msgspec.Struct], name: str) -> dict[str, Any]:
    """Return the schema, called `name`, of a struct whose fields are numbers, text, bytes, lists and other structs.

    Raises:
        TypeError: a field of another type.
    """
    return {"title": name, **_schema(inspect.type_info(kind))}


def _schema(of: inspect.Type) -> dict[str, Any]:
    match of:
        case inspect.Metadata():
            return _schema(of.type) | dict(of.extra_json_schema or {})
        case inspect.StructType():
            required = [f.encode_name for f in of.fields if f.required]
            out: dict[str, Any] = {"type": "object", "properties": {f.encode_name: _schema(f.type) for f in of.fields}}
            return out | ({"required": required} if required else {})
        case inspect.ListType():
            return {"type": "array", "items": _schema(of.item_type)}
        case inspect.UnionType():
            kinds = [t for t in of.types if not isinstance(t, inspect.NoneType)]
            if len(kinds) == 1:
                return _schema(kinds[0])
        case inspect.BytesType():
            return {"type": "string", "contentEncoding": "base64"}
        case inspect.StrType():
            return {"type": "string"}
        case inspect.BoolType():
            return {"type": "boolean"}
        case inspect.IntType():
            return {"type": "integer"}
        case inspect.FloatType():
            return {"type": "number"}
    raise TypeError(f"no viewer reads {of!r}")
