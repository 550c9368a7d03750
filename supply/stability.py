"""Describe what is public, and hold it to the committed description: `python -m supply.stability`.

`supply/public.json` has a line for each public name: the library's, settings, MQTT messages, topics of recordings, exit codes,
keys of `--json`, MAVLink parameters. `--write` renews it, and refuses to drop or change a line that CHANGELOG.md does not
announce under `Unreleased`. docs/stability.md says what may change and how.
"""

import argparse
import contextlib
import importlib
import inspect
import io
import json
import re
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from enum import Enum
from itertools import chain
from pathlib import Path

import msgspec
from msgspec import NODEFAULT

from companion.cli import main as command_line
from companion.facts.wire import FlightState
from companion.parts.mavlink.parameters import NAMES
from companion.parts.mqtt import messages
from companion.recording import channels
from companion.settings.model import Settings
from companion.settings.schema import expectation, walk
from companion.tools.doctor.finding import Finding
from estimator.contracts.keys import PUBLIC

ROOT = Path(__file__).parents[1]
DESCRIPTION = ROOT / "supply/public.json"
FACES = ("decklander", "estimator")
COMMANDS: Mapping[str, Sequence[str]] = {
    "simulate": ("simulate", "calm", "--seed", "1", "--perception", "truth"),
    "campaign": ("campaign", "calm", "--seed", "1", "--runs", "1", "--perception", "truth"),
    "detect": ("detect", str(ROOT / "tests/golden/frames.mcap")),
    "record info": ("record", "info", str(ROOT / "tests/golden/approach.mcap")),
}
"""Commands whose `--json` is described by what they print."""
_KINDS: Mapping[object, str] = {
    inspect.Parameter.VAR_POSITIONAL: "*",
    inspect.Parameter.VAR_KEYWORD: "**",
    inspect.Parameter.KEYWORD_ONLY: "keyword ",
}
_NESTED = ("summary", "touchdown", "contacts")
"""Objects in their answers whose keys are public too; those of others are names of the input."""


def description() -> dict[str, str]:
    """Return what is public, each name with its meaning."""
    made = chain(_python(), _settings(), _wire(), _answers(), _exit_codes().items(), _parameters().items())
    return dict(sorted(made))


def _python() -> Iterator[tuple[str, str]]:
    for face in FACES:
        module = importlib.import_module(face)
        for name in module.__all__:
            found = getattr(module, name)
            yield f"python {face}.{name}", _signature(found) if face == "decklander" else "as decklander's"
            if face == "decklander" and inspect.isclass(found):
                methods = {
                    key: value for key, value in inspect.getmembers(found) if key in vars(found) and not key.startswith("_")
                }
                yield from ((f"python {face}.{name}.{key}", _signature(value)) for key, value in methods.items())


def _signature(found: object) -> str:
    if inspect.isclass(found) and issubclass(found, Enum | Exception):
        return "enumeration" if issubclass(found, Enum) else "error"
    if not (inspect.isclass(found) or inspect.isroutine(found)):
        return "attribute"
    parameters = inspect.signature(found).parameters.values()
    return f"({', '.join(map(_parameter, parameters))})"


def _parameter(one: inspect.Parameter) -> str:
    return f"{_KINDS.get(one.kind, '')}{one.name}{'' if one.default is one.empty else '='}"


def _settings() -> Iterator[tuple[str, str]]:
    kinds: dict[str, set[str]] = {}
    for key, field in walk(Settings):
        if PUBLIC in (getattr(field.type, "extra_json_schema", None) or {}):
            default = "" if field.default is NODEFAULT else f"; {json.dumps(field.default, default=str)}"
            kinds.setdefault(key, set()).add(expectation(field.type) + default)
    return ((f"setting {key}", " | ".join(sorted(found))) for key, found in kinds.items())


def _wire() -> Iterator[tuple[str, str]]:
    for leaf, model in messages.PUBLISHED.items():
        yield f"mqtt topic {messages.ROOT}/DRONE/{leaf}", model.__name__
    for name, found in json.loads(messages.schema())["$defs"].items():
        yield from ((f"mqtt {name}.{key}", _type(kind)) for key, kind in found.get("properties", {}).items())
    yield from ((f"recording topic {topic}", record.__name__) for topic, record in channels.TOPICS.items())
    _, records = msgspec.json.schema_components(channels.TOPICS.values(), ref_template="{name}")
    for name, found in records.items():
        yield from ((f"recording {name}.{key}", _type(kind)) for key, kind in found.get("properties", {}).items())


def _type(kind: Mapping[str, object]) -> str:
    return json.dumps({key: value for key, value in kind.items() if key != "description"}, sort_keys=True)


def _answers() -> Iterator[tuple[str, str]]:
    yield from ((f"json doctor {field.name}", "key") for field in fields(Finding))
    yield from ((f"json fly status {field.encode_name}", "key") for field in msgspec.structs.fields(FlightState))
    for name, words in COMMANDS.items():
        out = io.StringIO()
        with (
            tempfile.TemporaryDirectory() as folder,
            contextlib.chdir(folder),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(io.StringIO()),
        ):
            command_line.main([*words, "--json"])
        for line in out.getvalue().splitlines():
            yield from ((f"json {name} {key}", "key") for key in _keys(json.loads(line)))


def _keys(found: Mapping[str, object], above: str = "") -> Iterator[str]:
    for key, value in found.items():
        yield above + key
        for below in value if isinstance(value, list) else (value,):
            if key in _NESTED and isinstance(below, dict):
                yield from _keys(below, f"{above}{key}.")


def _exit_codes() -> dict[str, str]:
    return {
        "exit code 0": "done",
        f"exit code {command_line.FAILED}": "it did not reach its goal",
        f"exit code {command_line.WRONG}": "wrong use or bad input, named in one line on standard error",
    }


def _parameters() -> dict[str, str]:
    return {f"mavlink parameter {name}": key for name, key in NAMES.items()}


def changes(committed: Mapping[str, str], found: Mapping[str, str], announced: str) -> list[str]:
    """Return a line for each public name that is gone or means something else without being announced.

    Args:
        committed: the description of before.
        found: that of now.
        announced: what CHANGELOG.md says under `Unreleased`; a name is announced by its last word in backticks.
    """
    lines = []
    for name, meaning in committed.items():
        if found.get(name) != meaning and f"`{name.split()[-1]}`" not in announced:
            now = f"is {found[name]}, was {meaning}" if name in found else "is gone"
            lines.append(
                f"{name} {now}: say so under Unreleased of CHANGELOG.md with `{name.split()[-1]}`, as docs/stability.md asks"
            )
    return lines


def announced(root: Path = ROOT) -> str:
    """Return what CHANGELOG.md says under `Unreleased`."""
    (text,) = re.findall(r"^## Unreleased\n(.*?)(?=^## )", (root / "CHANGELOG.md").read_text(), re.MULTILINE | re.DOTALL)
    return str(text)


def main() -> int:
    """Run the command: 0 where the description is that of the code, 1 where it is not."""
    parser = argparse.ArgumentParser(prog="python -m supply.stability", description="Hold what is public to its description.")
    parser.add_argument("--write", action="store_true", help="renew the description; an unannounced change is refused")
    args = parser.parse_args()
    committed, found = json.loads(DESCRIPTION.read_text()), description()
    lines = changes(committed, found, announced())
    if args.write and not lines:
        DESCRIPTION.write_text(json.dumps(found, indent=0) + "\n")
        committed = found
    if not lines and committed != found:
        lines = ["the description is old: python -m supply.stability --write"]
    print("\n".join(lines), end="\n" if lines else "")
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main())
