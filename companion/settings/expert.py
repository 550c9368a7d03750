"""Keep the keys of experts apart: in a settings file they stand under `[expert]`, in the same tables as the others.

`[expert.guidance.cone]` holds the keys of `[guidance.cone]` that are not declared with `public=True`.
"""

import inspect
from collections.abc import Iterator, Mapping
from types import UnionType
from typing import Any, Union, get_args, get_origin

from msgspec import Meta, Struct

from companion.settings.model import Settings
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import PUBLIC

EXPERT = "expert"


def joined(data: Mapping[str, Any], *, recorded: bool = False) -> dict[str, Any]:
    """Return the tables of a settings file with the keys below `[expert]` in the tables that they belong to.

    Args:
        data: the mapping of the file.
        recorded: the file belongs to a recording, which nobody can edit, so a key may stand on either side.

    Raises:
        BadInput: keys stand on the wrong side; the text names each with the table where it belongs.
    """
    inside = data.get(EXPERT, {})
    if not isinstance(inside, Mapping):
        raise BadInput(f"{EXPERT} must be a table of keys")
    outside = {name: value for name, value in data.items() if name != EXPERT}
    misplaced = [f"{path} belongs in [{EXPERT}.{path.rpartition('.')[0]}]" for path, public in _known(outside) if not public]
    misplaced += [f"{EXPERT}.{path} belongs in [{path.rpartition('.')[0]}]" for path, public in _known(inside) if public]
    if misplaced and not recorded:
        raise BadInput("; ".join(misplaced))
    return _merged(outside, inside)


def split(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of whole settings as a settings file has them: what `joined` joins."""
    outside: dict[str, Any] = {}
    inside: dict[str, Any] = {}
    for path, public in _known(tables):
        value: Any = tables
        for name in path.split("."):
            value = value[name]
        *above, last = path.split(".")
        place = outside if public else inside
        for name in above:
            place = place.setdefault(name, {})
        place[last] = value
    return {**outside, EXPERT: inside}


def in_file(path: str) -> str:
    """Return the dotted path of a key as a settings file has it; an unknown one stays as it is."""
    table: dict[str, Any] = {}
    place = table
    *above, last = path.split(".")
    for name in above:
        place = place.setdefault(name, {})
    place[last] = None
    return f"{EXPERT}.{path}" if any(not public for _, public in _known(table)) else path


def _known(data: Mapping[str, Any], kinds: tuple[type[Struct], ...] = (Settings,), above: str = "") -> Iterator[tuple[str, bool]]:
    """Yield the dotted path of each key that the settings know, and whether it is public."""
    for name, value in data.items():
        if any(name == kind.__struct_config__.tag_field for kind in kinds):
            yield above + name, True
            continue
        owners = (owner for kind in kinds for owner in kind.__mro__)
        annotation = next((a for owner in owners if (a := inspect.get_annotations(owner).get(name))), None)
        if inner := _structs(annotation):
            if isinstance(value, Mapping):
                yield from _known(value, inner, f"{above}{name}.")
        elif annotation is not None:
            yield above + name, any(isinstance(m, Meta) and PUBLIC in (m.extra_json_schema or {}) for m in get_args(annotation))


def _structs(annotation: Any) -> tuple[type[Struct], ...]:
    """Return the structs that a table of this type may be; none if it holds a single value."""
    kinds = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    return tuple(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Struct))


def _merged(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    out = dict(first)
    for name, value in second.items():
        here = out.get(name)
        out[name] = _merged(here, value) if isinstance(here, Mapping) and isinstance(value, Mapping) else value
    return out
