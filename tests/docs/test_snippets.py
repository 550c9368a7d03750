"""Commands of the docs work: blocks marked `run` are run, settings are loaded, and every command line parses.

`sh run` (with `exit=N`), `python run`, `toml rig`, `toml pad`. Every other line that
begins with `decklander` is parsed, not run.
"""

import argparse
import importlib
import os
import re
import shlex
import sys
import tomllib
from pathlib import Path

import pytest
from msgspec import Struct

from companion.cli.main import COMMANDS
from companion.settings.load import from_mapping
from estimator.vision.pad import Pad
from tests.support.processes import ran

ROOT = Path(__file__).parents[2]
PAGES = [*sorted(ROOT.glob("docs/**/*.md")), *(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY"))]


class Snippet(Struct, frozen=True):
    page: str
    line: int
    kind: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def snippets() -> list[Snippet]:
    found = []
    for page in PAGES:
        text = page.read_text()
        for block in re.finditer(r"^( *)```([^\n]*)\n(.*?)^\1```$", text, re.MULTILINE | re.DOTALL):
            indent = len(block[1])
            body = "".join(line[indent:] or "\n" for line in block[3].splitlines(keepends=True))
            found.append(Snippet(page.name, text.count("\n", 0, block.start()) + 1, block[2].strip(), body))
    return found


def of_kind(start: str) -> list[Snippet]:
    return [s for s in snippets() if s.kind.startswith(start)]


def command_lines() -> list[tuple[str, list[str]]]:
    """Return every line of any page that begins with the command, in a block or indented by four."""
    found = []
    for page in PAGES:
        for number, line in enumerate(page.read_text().splitlines(), 1):
            output = re.match(r"^(?: {3,}|)(?:\.venv/bin/)?(decklander [^|>&#;`]*)", line)
            if output is not None and "SOURCE..." not in line:
                typed = re.sub(r"\[[^\]]*\]", "", re.split(r" {2,}", output[1])[0]).strip(" \\")
                words = [word for word in shlex.split(typed)[1:] if word != "..."]
                if words:
                    found.append((f"{page.name}:{number}", words))
    return found


@pytest.mark.parametrize(("where", "words"), command_lines(), ids=lambda value: value if isinstance(value, str) else "")
def test_command_lines_parse(where: str, words: list[str]) -> None:
    assert words[0] in COMMANDS, where
    parser = argparse.ArgumentParser(prog="decklander", exit_on_error=False, allow_abbrev=False)
    importlib.import_module(COMMANDS[words[0]][0]).add_arguments(parser)
    try:
        parser.parse_args(words[1:])
    except (SystemExit, argparse.ArgumentError) as why:
        pytest.fail(f"{where}: decklander {' '.join(words)}: {why}")


@pytest.mark.parametrize("snippet", of_kind("sh run"), ids=str)
def test_shell_snippets_run(snippet: Snippet, tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/decklander").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m companion.cli.main "$@"\n')
    (tmp_path / "bin/decklander").chmod(0o755)
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    path = f"{tmp_path / 'bin'}:{os.environ['PATH']}"
    done = ran("sh", "-e", "-c", snippet.text, cwd=tmp_path, PATH=path)
    wanted = re.search(r"exit=(\d+)", snippet.kind)
    assert done.returncode == (int(wanted[1]) if wanted else 0), done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("snippet", of_kind("python run"), ids=str)
def test_python_snippets_run(snippet: Snippet, tmp_path: Path) -> None:
    done = ran(sys.executable, "-W", "error", "-c", snippet.text, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("snippet", of_kind("toml"), ids=str)
def test_settings_in_the_docs_are_good(snippet: Snippet) -> None:
    data = tomllib.loads(snippet.text)
    if snippet.kind == "toml pad":
        assert Pad.from_mapping(data, str(snippet)).disc_radius_m > 0
    else:
        assert snippet.kind == "toml rig"
        from_mapping(data, str(snippet))


def test_there_is_something_to_run() -> None:
    assert len(of_kind("sh run")) >= 2
    assert len(of_kind("python run")) >= 1
    assert len(of_kind("toml")) >= 2
    assert len(command_lines()) >= 10
