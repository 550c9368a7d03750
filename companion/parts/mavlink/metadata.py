"""Describe the parameters to ground stations: the files of MAVLink component metadata, made from the settings' own model.

A parameter's meaning, unit, range and default are those of its settings key, and its group is the key's table, so a ground
station shows what `docs/configuration.md` says. Events are not described: phases are sent as STATUSTEXT.

Source: mavlink.io, "Component Metadata Protocol", and the schemas of the mavlink repository (`component_metadata/`), whose keys
these are. The version of both files is 1, the only one that QGroundControl reads.
"""

import json
import lzma
from functools import cache, partial
from typing import Any

from msgspec import NODEFAULT, inspect

from companion.base.version import version
from companion.parts.mavlink.file_server import crc32
from companion.parts.mavlink.parameters import NAMES
from companion.settings.model import EXPERT, Settings
from companion.settings.schema import unit_of, walk
from drivers.mavlink.dialect import ComponentMetadata, Message, ms_since_boot
from estimator.contracts.keys import PUBLIC
from estimator.contracts.time import MonoNs

GENERAL, PARAMETERS, COMPRESSED = "general.json", "parameters.json", "parameters.json.xz"
_TYPE_PARAMETER = 1
"""COMP_METADATA_TYPE_PARAMETER."""
_json = partial(json.dumps, separators=(",", ":"))


@cache
def metadata_files(component: int) -> dict[str, bytes]:
    """Return the files of a component of ours by name: which metadata there are, and the parameters, plain and compressed."""
    fields = dict(walk(Settings))
    plain = _json({"version": 1, "parameters": [_parameter(name, key, fields[key]) for name, key in NAMES.items()]}).encode()
    # Ground stations decompress with XZ Embedded, which checks CRC-32 and allocates the whole dictionary.
    small = lzma.compress(plain, check=lzma.CHECK_CRC32, filters=[{"id": lzma.FILTER_LZMA2, "dict_size": 1 << 16}])
    found = {
        "type": _TYPE_PARAMETER,
        "uri": _uri(component, COMPRESSED),
        "fileCrc": crc32(small),
        "uriFallback": _uri(component, PARAMETERS),
        "fileCrcFallback": crc32(plain),
    }
    numbers = ".".join(version().split(".")[:3])
    known = {"firmwareVersion": numbers} if numbers.replace(".", "").isdigit() and numbers.count(".") == 2 else {}
    general = {"version": 1, "vendorName": "Decklander", "modelName": "companion", **known, "metadataTypes": [found]}
    return {GENERAL: _json(general).encode(), COMPRESSED: small, PARAMETERS: plain}


def metadata_message(component: int, now: MonoNs) -> Message:
    """Return COMPONENT_METADATA: where the general file of this component is, and its checksum."""
    return ComponentMetadata(ms_since_boot(now), crc32(metadata_files(component)[GENERAL]), _uri(component, GENERAL))


def _uri(component: int, name: str) -> str:
    return f"mftp://[;comp={component}]/{name}"


def _parameter(name: str, key: str, field: inspect.Field) -> dict[str, Any]:
    assert isinstance(field.type, inspect.Metadata)
    assert isinstance(field.type.type, inspect.FloatType | inspect.IntType)
    notes = field.type.extra_json_schema or {}
    unit, written = unit_of(field.type), key if PUBLIC in notes else f"{EXPERT}.{key}"
    described = {
        "name": name,
        "type": "Float",
        "shortDesc": notes["description"],
        "longDesc": ". ".join(filter(None, (f"Setting {written}", notes.get("x-source", "")))),
        "units": "" if unit == "1" else unit,
        "min": field.type.type.ge,
        "max": field.type.type.le,
        "group": key.rpartition(".")[0],
        "category": "Decklander",
    }
    return described if field.default is NODEFAULT else described | {"default": field.default}
