"""Outputs of commands: what is read, what is somebody's own, and a file of another kind stay as they are."""

import argparse
import importlib
from pathlib import Path

import pytest

from companion.cli.main import COMMANDS, Parser, add_command, main
from companion.cli.outputs import Output


def _parsers(parser: argparse.ArgumentParser, words: tuple[str, ...] = ()):
    yield words, parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, inner in action.choices.items():
                yield from _parsers(inner, (*words, name))


def _outputs() -> list[tuple[tuple[str, ...], Output, argparse.ArgumentParser]]:
    top = Parser(prog="decklander")
    subparsers = top.add_subparsers()
    for name, (module, _) in COMMANDS.items():
        add_command(subparsers, name, importlib.import_module(module))
    return [(words, one, parser) for words, parser in _parsers(top) for one in parser.get_default("outputs") or ()]


OUTPUTS = _outputs()
IDS = [" ".join((*words, one.option)) for words, one, _ in OUTPUTS]


def _words(words: tuple[str, ...], one: Output, parser: argparse.ArgumentParser, read: Path, out: Path) -> list[str]:
    """Return a command line with every argument that must be given, its files being `read`."""
    given = [*words]
    for action in parser._actions:
        if action.required and action.dest != one.dest:
            value = next(iter(action.choices)) if action.choices else str(read)
            given += [*action.option_strings[:1], value]
    return [*given, one.option, str(out)]


@pytest.mark.parametrize(("words", "one", "parser"), OUTPUTS, ids=IDS)
def test_a_command_writes_over_nothing_that_it_reads_or_that_is_not_its_own(words, one, parser, tmp_path, capsys) -> None:
    read = tmp_path / f"mine{one.kind.endings[0]}"
    read.write_bytes(b"somebody's")
    assert main(_words(words, one, parser, read, read)) == 2
    reads = any(action.required and action.dest != one.dest for action in parser._actions)
    assert ("which is read" if reads else "already") in capsys.readouterr().err
    other = tmp_path / "other.xyz"
    other.write_bytes(b"somebody's")
    assert main(_words(words, one, parser, read, other)) == 2
    assert "must end in" in capsys.readouterr().err
    third = tmp_path / f"third{one.kind.endings[-1]}"
    third.write_bytes(b"somebody's")
    assert main(_words(words, one, parser, read, third)) == 2
    assert "already" in capsys.readouterr().err
    assert main(_words(words, one, parser, read, Path(f"/proc/none{one.kind.endings[0]}"))) == 2
    assert {path.read_bytes() for path in tmp_path.iterdir()} == {b"somebody's"}
    assert len(list(tmp_path.iterdir())) == 3


def test_each_output_of_the_command_line_is_declared_as_one() -> None:
    options = " ".join(sorted({one.option for _, one, _ in OUTPUTS}))
    assert options == "--animation --out --output --plot --record --save --write"
    assert len(OUTPUTS) > 15


@pytest.mark.parametrize("value", ["a" * 5000, "a\0b", ""])
def test_an_argument_that_can_be_no_file_s_name_is_judged_as_what_it_is(value: str, tmp_path: Path) -> None:
    assert main(["simulate", "calm", "--record", str(tmp_path / "new.mcap"), "--set", f"wind.{value}=1"]) == 2
    assert list(tmp_path.iterdir()) == []


def test_a_folder_or_a_device_is_no_file_to_write(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "null.mcap").symlink_to("/dev/null")
    for name in ("folder.mcap", "null.mcap"):
        assert main(["simulate", "calm", "--force", "--record", str(tmp_path / name)]) == 2
        assert "name a new one" in capsys.readouterr().err
    assert Path("/dev/null").is_char_device()
