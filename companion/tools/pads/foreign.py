"""Read drawings and boards from elsewhere by other libraries, in a process of its own (`drivers.files.in_child`)."""

import json
import sys
from collections.abc import Callable, Mapping
from functools import partial

from drivers.confined import confined_task
from drivers.extras import require
from estimator.contracts.errors import BadInput

PX_IN_INCH = 96.0
"""Pixels of an inch in SVG."""


def _render(svg: bytes, *, crisp: bool) -> bytes:
    """Return a drawing as PNG; a crisp one is blended at no border."""
    require("a pad from a drawing", "pads", "resvg_py")
    import resvg_py

    sharp = "*{shape-rendering:crispEdges!important}" if crisp else None
    try:
        return resvg_py.svg_to_bytes(svg.decode(), skip_system_fonts=True, dpi=PX_IN_INCH, style_sheet=sharp)
    except ValueError as why:
        raise BadInput(f"no SVG drawing: {why}") from why


def _json_of_yaml(text: bytes) -> bytes:
    """Return the content of a YAML file as JSON."""
    try:
        from ruamel.yaml import YAML
        from ruamel.yaml.error import YAMLError
    except ImportError as why:
        raise BadInput("YAML is read with the extra decklander[ros2], which is not installed") from why
    try:
        return json.dumps(YAML(typ="safe", pure=True).load(text.decode().lstrip("\ufeff"))).encode()
    except (YAMLError, TypeError, ValueError, RecursionError) as why:
        raise BadInput(f"no YAML: {why}") from why


_TASKS: Mapping[str, Callable[[bytes], bytes]] = {
    "crisp": partial(_render, crisp=True), "blended": partial(_render, crisp=False), "yaml": _json_of_yaml,
}  # fmt: skip

if __name__ == "__main__":
    sys.exit(confined_task(_TASKS))
