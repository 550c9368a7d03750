"""The native core fits the interface that Python expects, or is refused with the cure; its build runs under the sanitizers."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from estimator.contracts.errors import SetupImpossible
from estimator.core import interface
from estimator.core.library import CORE, address, load
from sitl.core.library import CORE as SIM_CORE
from supply import core

ROOT = Path(__file__).parents[3]
DIGEST_ALONE = core.FLYING.part("base/digest.c")


def test_the_header_is_made_of_the_interface() -> None:
    assert core.HEADER.read_text() == core.header(), "python -m supply.core --header"


def test_every_function_is_defined_in_its_file_and_declared_to_python() -> None:
    for function in interface.FUNCTIONS:
        assert re.search(rf"^\w+ {function.name}\(", (ROOT / function.source).read_text(), re.MULTILINE), function
        parameters = 0 if function.parameters == "void" else function.parameters.count(",") + 1
        library = SIM_CORE if function.source.startswith("sitl/") else CORE
        assert len(library.function(function.name).argtypes) == parameters
    with pytest.raises(KeyError, match="no function 'take_off'"):
        CORE.function("take_off")


def test_a_missing_library_or_one_of_another_interface_is_refused_with_the_cure(tmp_path: Path) -> None:
    with pytest.raises(SetupImpossible, match=r"none\.so cannot be loaded .*make core"):
        load(str(tmp_path / "none.so"))
    (tmp_path / "torn.so").write_bytes(core.FLYING.file.read_bytes()[:100])
    with pytest.raises(SetupImpossible, match=r"torn\.so cannot be loaded .*make core"):
        load(str(tmp_path / "torn.so"))
    flags = (f"-DINTERFACE_DIGEST={interface.digest() ^ 1}u",)
    other = core.build(DIGEST_ALONE, tmp_path / "other.so", flags)
    with pytest.raises(SetupImpossible, match=rf"built for interface {interface.digest() ^ 1:08x}, this code needs .*make core"):
        load(str(other))


def test_a_library_without_the_core_in_it_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.c").write_text("int nothing(void) { return 0; }\n")
    subprocess.run([*core.compiler(), "-shared", "-fPIC", "empty.c", "-o", "empty.so"], cwd=tmp_path, check=True)
    with pytest.raises(SetupImpossible, match=r"empty\.so is not the native core; .*make core"):
        load(str(tmp_path / "empty.so"))


def test_the_command_line_says_the_cure_in_one_line(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "estimator", tmp_path / "estimator", ignore=shutil.ignore_patterns("*.so*", "__pycache__"))
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from companion.cli.main import main; sys.exit(main(sys.argv[1:]))"
    said = subprocess.run(
        [sys.executable, "-c", code, "simulate", "calm"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert said.returncode == 1
    assert "make core" in said.stderr
    assert len(said.stderr.splitlines()) == 1, said.stderr


def test_without_a_compiler_the_build_names_both(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(core.BuildError, match=r"apt install gcc.*compiler\.txt"):
        core.build(core.FLYING)


def test_a_source_that_the_compiler_refuses_leaves_the_library_as_it_was(tmp_path: Path) -> None:
    out = tmp_path / "libdecklander.so.1"
    out.write_bytes(b"before")
    with pytest.raises(core.BuildError, match="INTERFACE_DIGEST"):
        core.build(DIGEST_ALONE, out, ("-DINTERFACE_DIGEST=(",))
    assert out.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [out]


def test_an_array_that_c_would_misread_is_refused() -> None:
    assert address(np.zeros((2, 2))) != 0
    with pytest.raises(TypeError, match="float32"):
        address(np.zeros(3, dtype=np.float32))
    with pytest.raises(TypeError, match="strides"):
        address(np.zeros((3, 3)).T[:, :2])


def test_the_core_runs_clean_under_the_sanitizers(tmp_path: Path) -> None:
    flags = ["-std=c99", "-g", "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    program = tmp_path / "exercise"
    command = [*core.compiler(), *flags, *core.all_in_one(), str(ROOT / "tests/estimator/core/exercise.c")]
    built = subprocess.run([*command, "-o", str(program), "-lm"], capture_output=True, text=True, check=False)
    if built.returncode != 0 and re.search("sanitize|asan|ubsan", built.stderr):
        pytest.skip("this compiler has no sanitizers")
    assert built.returncode == 0, built.stderr
    ran = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert {function.name for function in interface.FUNCTIONS} <= set(ran.stdout.split()), "exercise.c misses a function"
