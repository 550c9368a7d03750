"""The mutation tester: it changes what decides, leaves texts alone, and tells a test that notices from one that does not."""

import ctypes
import subprocess
import sys
from pathlib import Path

import pytest

from mutants.__main__ import HEAD, write_table
from mutants.c_operators import c_mutants
from mutants.judge import Tally, chosen
from mutants.native import Workshop
from mutants.operators import Mutant, mutants
from mutants.table import TARGETS
from supply import core

ROOT = Path(__file__).parents[2]

SOURCE = '''"""A gate."""
LIMIT: float = 2.0


def good(x: float, told: bool = True) -> bool:
    """At most 2.0."""
    if not told:
        raise ValueError(f"told {1 + 1}")
    return x < LIMIT and x > -1
'''


def test_each_change_is_one_and_texts_are_left_alone() -> None:
    found = list(mutants(SOURCE))
    changes = {m.change for m in found}
    assert {"2.0  ->  4.0", "2.0  ->  0.0", "True  ->  False", "x < LIMIT  ->  x <= LIMIT", "x < LIMIT  ->  x > LIMIT"} <= changes
    assert {"-1  ->  1", "not told  ->  told", "if not told  ->  if True"} <= changes
    assert any(change.startswith("x < LIMIT and x > -1  ->  x < LIMIT or x > -1") for change in changes)
    assert all(m.source.count("told {1 + 1}") == 1 and "At most 2.0." in m.source for m in found)
    assert len({m.source for m in found}) == len(found)
    assert all(compile(m.source, "mutant", "exec") for m in found)


C_SOURCE = """/* 1.0 + 2.0 */
#define SIZE 3
static const double LIMIT = 2.0;

int good(const double *x, int n)
{
    double half = 0.5 * n, w[3] = {0.0};
    w[0] = x[1] * -1.0;
    return w[0] < LIMIT && n > 0;
}
"""


def test_each_change_of_a_c_source_is_one_and_leaves_comments_and_sizes_alone() -> None:
    found = list(c_mutants(C_SOURCE))
    changes = {m.change for m in found}
    assert "w[0] = x[1] * -1.0;  ->  w[0] = x[1] / -1.0;" in changes
    assert "return w[0] < LIMIT && n > 0;  ->  return w[0] <= LIMIT && n > 0;" in changes
    assert "return w[0] < LIMIT && n > 0;  ->  return w[0] < LIMIT || n > 0;" in changes
    assert "static const double LIMIT = 2.0;  ->  static const double LIMIT = 0.0;" in changes
    assert all(m.source.startswith("/* 1.0 + 2.0 */\n#define SIZE 3\n") for m in found)
    assert not any("w[4]" in change or "double /x" in change for change in changes)
    assert len({m.source for m in found}) == len(found)
    assert "double half = 0.5 * n, w[3] = {0.0};  ->  double half = 0.5 / n, w[3] = {0.0};" in changes
    assert {(m.line, m.within) for m in found} == {(3, ""), (7, "good"), (8, "good"), (9, "good")}


def test_a_sample_is_the_same_for_the_same_seed_and_of_the_share_requested() -> None:
    rows = [Mutant(i, f"{i}  ->  {i + 1}", "") for i in range(2000)]
    drawn = [m for m in rows if chosen("a.py", m, 0.1, 1)]
    assert 140 < len(drawn) < 260
    assert drawn == [m for m in rows if chosen("a.py", m, 0.1, 1)]
    assert drawn != [m for m in rows if chosen("a.py", m, 0.1, 2)]
    assert all(chosen("a.py", m, 1.0, 1) for m in rows)


def test_what_is_mutated_and_its_tests_are_there() -> None:
    for path, tests in TARGETS.items():
        assert (ROOT / path).is_file()
        assert all((ROOT / test.partition("::")[0]).exists() for test in tests)


def test_a_test_that_notices_kills_and_one_that_does_not_lets_live(tmp_path: Path) -> None:
    (tmp_path / "gatekeeper.py").write_text("def good(x):\n    return x < 2\n\n\ndef unseen(x):\n    return x + 1\n")
    (tmp_path / "test_gatekeeper.py").write_text(
        "from gatekeeper import good\n\ndef test_good():\n    assert good(1)\n    assert not good(2)\n"
    )
    (tmp_path / "pytest.ini").write_text("[pytest]\npythonpath = .\n")
    program = (
        "from pathlib import Path; from mutants.judge import judge\n"
        f"t = judge('gatekeeper.py', ['test_gatekeeper.py'], 1.0, 1, root=Path({str(tmp_path)!r}))\n"
        "print(t.killed, sorted(m.change for m in t.survivors))"
    )

    def judged() -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", program]
        return subprocess.run(
            command, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False, timeout=100
        )

    assert judged().stdout.splitlines()[-1] == "3 ['1  ->  2', 'x + 1  ->  x - 1']"
    (tmp_path / "gatekeeper.py").write_text("def good(x):\n    return x < 1\n")
    broken = judged()
    assert broken.returncode == 1
    assert "its tests do not pass as it is" in broken.stderr


def test_a_change_of_c_is_compiled_alone_and_one_that_the_compiler_sees_through_is_no_change(tmp_path: Path) -> None:
    sources, made = tmp_path / "core", tmp_path / "made"
    sources.mkdir()
    made.mkdir()
    original = "int half(int x);\nint half(int x)\n{\n    return x > 0 ? x / 2 : 0 * 2;\n}\n"
    (sources / "a.c").write_text(original)
    of_header = "int half(int x);\nint used(int x);\nint used(int x)\n{\n    return half(x) + (HEADER_DIGEST == 0u);\n}\n"
    (sources / "b.c").write_text(of_header)
    (made / "empty.h").touch()
    library = core.Library(made / "all.so", made / "empty.h", (sources / "a.c", sources / "b.c"), (sources,))
    shop = Workshop(made, library, sources / "a.c")
    assert ctypes.CDLL(str(shop.linked("original.so"))).used(8) == 5
    assert shop.alike(original.replace("0 * 2", "0 / 2"), ["-O2"])
    quarter = original.replace("x / 2", "x / 4")
    assert not shop.alike(quarter, ["-O2"])
    assert ctypes.CDLL(str(shop.linked("mutant.so", shop.compiled(quarter, "mutant.c")))).used(8) == 3
    with pytest.raises(core.BuildError):
        shop.compiled(original.replace("x > 0", "y > 0"), "mutant.c")


def test_the_page_keeps_the_rows_of_files_that_were_not_tried(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    first, second = list(TARGETS)[:2]
    page.write_text(f"Killed:\n\n{HEAD[0]}\n{HEAD[1]}\n| `{first}` | 1 |\n\nEnd.\n")
    write_table(page, [Tally(second, killed=19, survivors=[Mutant(1, "a", "b")], alike=2)], 0.5)
    lines = page.read_text().splitlines()
    assert lines[4:] == [f"| `{first}` | 1 |", f"| `{second}` | 20 | 19 | 2 | 50 % |", "", "End."]
