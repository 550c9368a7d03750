"""Every kept input through its target again, without the fuzzer; and the harness that must notice when one breaks."""

import gc
import sys
from pathlib import Path

import pytest

from fuzz import __main__ as fuzz
from fuzz import native
from fuzz.target import CORPUS, MODULES, Finds, signature, target

ROOT = Path(__file__).parents[2]


@pytest.mark.filterwarnings(
    "default",  # what a library says of a damaged log is no failure, but a file that is left open is
    "error::ResourceWarning",
    "error::pytest.PytestUnraisableExceptionWarning",
)
@pytest.mark.parametrize("name", MODULES)
def test_the_corpus_keeps_the_contract(name: str) -> None:
    chosen = target(name)
    kept = sorted((CORPUS / name).iterdir())
    assert kept, "no seed: python -m fuzz.seeds"
    for path in kept:
        data = path.read_bytes()
        assert len(data) <= chosen.max_len
        chosen.run(data)
    chosen.run(b"")
    gc.collect()


@pytest.mark.parametrize("name", ["mavlink_codec", "at", "uvlc", "mcap_messages"])
def test_a_target_answers_the_same_twice(name: str) -> None:
    """State that one input leaves must not change the result of the next: damaged seeds, in two orders."""
    chosen = target(name)
    inputs = [path.read_bytes()[::-1] for path in sorted((CORPUS / name).iterdir())[:6]]
    answers = []
    for row in (inputs, inputs[::-1]):
        answers.append({data: _answer(chosen.run, data) for data in row})
    assert answers[0] == answers[1]


def _answer(run: object, data: bytes) -> str:
    assert callable(run)
    try:
        run(data)
    except Exception as why:
        return signature(why, ROOT)
    return "held"


def test_a_fault_is_kept_once_with_its_shortest_input(tmp_path: Path) -> None:
    finds = Finds("x", tmp_path, ROOT)

    def fault(data: bytes) -> None:
        try:
            raise ExceptionGroup("of a task", [KeyError(data)])
        except ExceptionGroup as why:
            finds.note(data, why)

    for data in (b"long input", b"in", b"longer than that"):
        fault(data)
    (kept,) = tmp_path.glob("*.bin")
    assert kept.read_bytes() == b"in"
    assert "KeyError at" in kept.with_suffix(".txt").read_text()


def test_the_command_shows_a_fault_and_a_hang_and_ends_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A stand-in replaces the fuzzer's process, which the suite does not install: its lines are libFuzzer's."""
    stand_in = tmp_path / "python"
    stand_in.write_text(
        f"#!{sys.executable}\nimport pathlib, sys\n"
        "print('#4096\\tpulse  cov: 77 ft: 123 corp: 9/1Kb', file=sys.stderr)\n"
        "print('stat::number_of_executed_units: 5000', file=sys.stderr)\n"
        "folder = pathlib.Path(sys.argv[sys.argv.index('--crashes') + 1])\n"
        "if sys.argv[3] == 'at':\n"
        "    folder.mkdir(parents=True); (folder / 'at-1.txt').write_text('at: KeyError at a.py:1\\n')\n"
        "if sys.argv[3] == 'pave':\n"
        "    print('==9== ERROR: libFuzzer: timeout after 21 seconds', file=sys.stderr); sys.exit(70)\n"
    )
    stand_in.chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "executable", str(stand_in))
        assert fuzz.run(["control"], 1.0, 1, tmp_path / "a") == 0
        assert fuzz.run(["control", "at", "pave"], 1.0, 1, tmp_path / "b") == 1
    output = capsys.readouterr().out
    assert "5000     77      123" in output
    assert "15000 executions, 231 edges, 2 faults" in output
    assert "at: KeyError at a.py:1" in output
    assert "pave: timeout after 21 seconds" in output


def test_a_fault_of_the_native_core_is_shown_with_its_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = "core/sea.c:33:22: runtime error: -nan is outside the range of representable values of type 'long'"
    code = f"import sys; print({output!r}, file=sys.stderr); sys.exit(1)"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "command", lambda *_: [sys.executable, "-c", code])
        assert fuzz.run(["core"], 1.0, 1, tmp_path) == 1
    assert f"core: {output}" in capsys.readouterr().out
