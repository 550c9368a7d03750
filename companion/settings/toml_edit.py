"""Change single values of a TOML file and leave everything else of it as a person wrote it, comments included."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from typing import Any

from estimator.contracts.errors import BadInput

Value = float | int | str | list[float] | list[list[float]]


def with_values(text: str, table: str, values: Mapping[str, Value], where: str) -> str:
    """Return the text with values set in a table; a key or table that is not there is added at the end of its place.

    Args:
        table: dotted name of the table; "" for the keys before the first table.
        where: names the file in errors.

    Raises:
        BadInput: the text is no TOML, or the keys are written in a way that a change of lines cannot reach.
    """
    wanted = _parsed(text, where)
    place: dict[str, Any] = wanted
    for name in table.split(".") if table else ():
        place = place.setdefault(name, {})
        if not isinstance(place, dict):
            raise BadInput(f"{where}: {table} is not a table")
    place |= values
    lines = text.splitlines()
    for key, value in values.items():
        _set(lines, table, key, _written(value))
    out = "\n".join(lines) + "\n"
    try:
        same = tomllib.loads(out) == wanted
    except tomllib.TOMLDecodeError:
        same = False
    if not same:
        listed = ", ".join(f"{key} = {_written(value)}" for key, value in values.items())
        raise BadInput(f"{where}: cannot be changed line by line; set {listed} by hand" + (f" in [{table}]" if table else ""))
    return out


def _set(lines: list[str], table: str, key: str, written: str) -> None:
    first, end = _span(lines, table)
    for i in range(first, end):
        if re.match(rf"\s*{re.escape(key)}\s*=", lines[i]):
            last = _last_line(lines, i, end)
            _, mark, comment = lines[last].partition("#")
            lines[i : last + 1] = [f"{key} = {written}" + (f"  {mark}{comment}" if mark else "")]
            return
    while end > first and not lines[end - 1].strip():
        end -= 1
    lines.insert(end, f"{key} = {written}")


def _span(lines: list[str], table: str) -> tuple[int, int]:
    """Return the lines of a table after its header; the table is added if it is not there."""
    headers = [i for i, line in enumerate(lines) if line.lstrip().startswith("[") and _is_header(line)]
    first = 0
    if table:
        found = [i for i in headers if lines[i].partition("#")[0].strip() == f"[{table}]"]
        if not found:
            lines += ["", f"[{table}]"]
            return len(lines), len(lines)
        first = found[0] + 1
    return first, next((i for i in headers if i >= first), len(lines))


def _is_header(line: str) -> bool:
    try:
        return bool(tomllib.loads(line))
    except tomllib.TOMLDecodeError:
        return False


def _last_line(lines: list[str], i: int, end: int) -> int:
    """Return the line on which the value that begins on line `i` ends."""
    for last in range(i, end):
        try:
            tomllib.loads("\n".join(lines[i : last + 1]))
        except tomllib.TOMLDecodeError:
            continue
        return last
    return i


def _written(value: Value) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_written(v) for v in value) + "]"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    return repr(value)


def _parsed(text: str, where: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as why:
        raise BadInput(f"{where}: {why}") from why
