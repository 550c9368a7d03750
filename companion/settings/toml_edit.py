"""Change single values of a TOML file and leave everything else of it as a person wrote it, comments included."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from estimator.contracts.errors import BadInput


def with_values(text: str, table: str, values: Mapping[str, Any], where: str) -> str:
    """Return the text with values set in a table; a key or table that is not there is added at the end of its place.

    Args:
        table: dotted name of the table; "" for the keys before the first table.
        where: names the file in errors.

    Raises:
        BadInput: the text is no TOML, or the table's name is that of a value.
    """
    try:
        document = tomlkit.parse(text)
    except TOMLKitError as why:
        raise BadInput(f"{where}: {why}") from why
    place: MutableMapping[str, Any] = document
    for name in table.split(".") if table else ():
        place = place.setdefault(name, tomlkit.table())
        if not isinstance(place, MutableMapping):
            raise BadInput(f"{where}: {table} is not a table")
    place.update(values)
    return tomlkit.dumps(document)
