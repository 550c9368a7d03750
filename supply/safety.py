"""Write docs/safety.md: hazards by STPA (safety.toml), each with its constraint, the count of its tests and what measures it.

`python -m supply.safety` prints the page, and with the name of a hazard its tests. A test that shows a hazard's constraint
carries `@pytest.mark.hazard("H1")`.
Source of the method: N. Leveson and J. Thomas, STPA Handbook, 2018, chapter 2.
"""

import ast
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
SAID = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def marked_tests() -> dict[str, list[str]]:
    """Return the tests of each hazard as `path::name`, sorted; a mark with an unknown name has an entry of its own."""
    found: dict[str, list[str]] = {}
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        text = path.read_text()
        if "mark.hazard" not in text:
            continue
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                for mark in node.decorator_list:
                    if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.hazard":
                        for name in mark.args:
                            test = f"{path.relative_to(ROOT).as_posix()}::{node.name}"
                            found.setdefault(ast.literal_eval(name), []).append(test)
    return found


def page() -> str:
    """Return docs/safety.md."""
    tests, words = marked_tests(), SAID["words"]
    lines = words["head"].format(losses="; ".join(f"{name} {text}" for name, text in SAID["losses"].items())).splitlines()
    for name, hazard in SAID["hazards"].items():
        lines += [
            f"## {name}: {hazard['name']}",
            "",
            f"- Losses: {', '.join(hazard['losses'].split())}. Unsafe: {hazard['unsafe']}.",
            f"- Constraint: {hazard['constraint']}",
            f"- Measured by: {hazard['figure']}",
            f"- Tests: {len(tests.get(name, []))}",
            "",
        ]
    lines += ["## What is not covered", "", *[f"- {text}" for text in words["not_covered"]], "", *words["sora"].splitlines()]
    lines += [f"| {question} | {answer} |" for question, answer in SAID["sora"].items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write("\n".join(marked_tests().get(sys.argv[1], [])) + "\n" if sys.argv[1:] else page())
