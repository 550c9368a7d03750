"""Outputs of commands: what is read, what is somebody's own, and a file of another kind stay as they are."""

import argparse
import importlib
import os
import resource
import sys
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from companion.base.version import MARK
from companion.cli.commands import COMMANDS
from companion.cli.main import Parser, add_command, main
from companion.cli.outputs import EXPERIMENTS, PLOT, REPORT, Output, check_output, checked_outputs
from companion.settings.load import write_whole
from companion.tools.report.page import write_page
from companion.tools.report.page_parts import document
from estimator.contracts.errors import BadInput


def _parsers(parser: argparse.ArgumentParser, words: tuple[str, ...] = ()):
    yield words, parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, inner in action.choices.items():
                yield from _parsers(inner, (*words, name))


def _commands() -> list[tuple[tuple[str, ...], argparse.ArgumentParser]]:
    top = Parser(prog="decklander")
    subparsers = top.add_subparsers()
    for name, command in COMMANDS.items():
        add_command(subparsers, name, importlib.import_module(command.module))
    return list(_parsers(top))


OUTPUTS = [(words, one, parser) for words, parser in _commands() for one in parser.get_default("outputs") or ()]
IDS = [" ".join((*words, one.option)) for words, one, _ in OUTPUTS]
READ = {
    "recording", "recordings", "other", "files", "paths", "sources", "folder", "foreign", "drawing", "pad", "log", "--scenario",
    "--camera", "--camera-file", "--pad", "--attitude", "--second-opinion", "--config", "--compare", "--mapping",
    "--password-file", "--ca-file", "--token-file", "--picture", "--signing-key", "--snapshot", "--undo", "--perception-model",
    "--binary", "--against", "--from", "--photos", "--current", "config show file", "keys show file", "keys install file",
}  # fmt: skip
"""Arguments that name what a command reads; every other path is written, and must be declared as an output."""


def test_each_path_that_no_command_reads_is_declared_as_an_output() -> None:
    undeclared = []
    for words, parser in _commands():
        declared = {one.dest for one in parser.get_default("outputs") or ()}
        for action in parser._actions:
            name = (action.option_strings or [action.dest])[-1]
            path = action.type is Path or action.metavar in ("FILE", "DIR", "PATH", "FOLDER")
            if path and action.dest not in declared and READ.isdisjoint((name, " ".join((*words, name)))):
                undeclared.append(" ".join((*words, name)))
    assert undeclared == []
    assert len(OUTPUTS) > 30


def _words(words: tuple[str, ...], one: Output, parser: argparse.ArgumentParser, read: Path, out: Path) -> list[str]:
    """Return a command line with every argument that must be given, its files being `read`."""
    given, written = [*words], {other.dest: other.kind for other in parser.get_default("outputs")}
    for action in parser._actions:
        if action.required and action.dest != one.dest:
            value = next(iter(action.choices)) if action.choices else str(read)
            if action.dest in written:
                value = str(read.with_name(f"new{written[action.dest].endings[0]}"))
            given += [*action.option_strings[:1], value]
    return [*given, *([one.option] if one.option.startswith("-") else []), str(out)]


@pytest.mark.parametrize(("words", "one", "parser"), OUTPUTS, ids=IDS)
def test_a_command_writes_over_nothing_that_it_reads_or_that_is_not_its_own(words, one, parser, tmp_path, capsys) -> None:
    kind = one.kind
    endings = kind.endings or ("",)
    read, third = (tmp_path / f"{name}{ending}" for name, ending in (("mine", endings[0]), ("third", endings[-1])))
    cases = [(third, "already")]
    if kind.inside is None or kind.endings:
        reads = any(action.required and action.dest != one.dest for action in parser._actions)
        cases.append((read, "which is read" if reads else "already"))
    else:
        (folder := tmp_path / "folder").mkdir()
        inside = [folder / pattern.replace("*", "x") for pattern in kind.inside if "/" not in pattern]
        cases = [(folder, "already")] * bool(inside)
        third = (inside or [third])[-1]
    if kind.endings and kind.inside is None:
        cases.append((tmp_path / "other.xyz", "must end in"))
    written = {read, third, *(path for path, _ in cases if path.suffix)}
    for path in written:
        path.write_bytes(b"somebody's decklander, by Matplotlib")
    for path, why in [*cases, (Path(f"/proc/none{endings[0]}"), "/proc/none")]:
        assert main(_words(words, one, parser, read, path)) == 2
        assert why in capsys.readouterr().err
    left = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert left == dict.fromkeys(written, b"somebody's decklander, by Matplotlib")


def test_a_file_that_another_command_is_writing_is_refused_until_that_one_ends(tmp_path: Path) -> None:
    args = argparse.Namespace(outputs=(Output("--plot", "plot", PLOT),), plot=tmp_path / "a.png")
    for _ in range(2):
        with checked_outputs(args), pytest.raises(BadInput, match="another command is writing it"), checked_outputs(args):
            pass


def test_what_only_we_write_is_replaced_and_all_else_by_force_alone(tmp_path: Path) -> None:
    for kind, name, ours in (
        (REPORT, "a.html", document("Flight", "<p>")),
        (EXPERIMENTS, "experiments.md", "# The thesis' experiments again\n\nMade by `decklander experiments`. The thesis"),
    ):
        path = tmp_path / name
        given = path if kind is REPORT else tmp_path
        path.write_text("<!doctype html><p>How decklander landed, made by decklander")
        with pytest.raises(BadInput, match="--force replaces it"):
            check_output(given, kind, "--output", [])
        check_output(given, kind, "--output", [], force=True)
        path.write_text(ours)
        check_output(given, kind, "--output", [])
    for ending in PLOT.endings:
        path = tmp_path / f"plot{ending}"
        (figure := Figure()).savefig(path)
        with pytest.raises(BadInput, match="already"):
            check_output(path, PLOT, "--plot", [])
        figure.savefig(path, metadata=MARK)
        check_output(path, PLOT, "--plot", [])


@pytest.mark.parametrize("words", ["pad print --out x.pdf", "pad print --paper full --out x.svg", "doctor --write copter.param"])
def test_a_file_that_a_full_disk_cuts_short_does_not_bear_its_name(words: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # Python would keep a module's that is cut short
    limits, path = resource.getrlimit(resource.RLIMIT_FSIZE), Path(words.split()[-1])
    for before in ([], [path]):
        resource.setrlimit(resource.RLIMIT_FSIZE, (512, limits[1]))
        try:
            assert main([*words.split(), "--force"]) == 1
            with pytest.raises(BadInput, match="cannot write the report"):
                write_page(path, "x" * 1000)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert list(Path().iterdir()) == before
        path.touch()
    assert path.stat().st_size == 0


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


def test_a_pipe_gets_what_is_written_and_stays_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(pipe := tmp_path / "pipe")
    reads = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_whole(pipe, "all")
    assert (os.read(reads, 9), pipe.is_fifo(), list(tmp_path.iterdir())) == (b"all", True, [pipe])
    os.close(reads)
