"""Write docs/safety.md: hazards and unsafe control actions by STPA (safety.toml), with constraints and counts of tests.

`python -m supply.safety` prints the page, and with the name of a hazard or an action its tests. A test that shows a constraint
carries `@pytest.mark.hazard("H6", "A2")`.
Source of the method: N. Leveson and J. Thomas, STPA Handbook, 2018, chapter 2.
"""

import ast
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
SAID = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def marked_tests() -> dict[str, list[str]]:
    """Return the tests of each hazard and action as `path::name`, sorted; a mark with an unknown name has an entry of its own."""
    found: dict[str, list[str]] = {}
    for path in sorted(path for folder in ("tests", "qualification") for path in (ROOT / folder).rglob("test_*.py")):
        text = path.read_text()
        if "mark.hazard" not in text:
            continue
        for node in ast.parse(text).body:
            name = node.name if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) else ast.unparse(node).split(" ")[0]
            for mark in ast.walk(node):
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.hazard":
                    for row in mark.args:
                        found.setdefault(ast.literal_eval(row), []).append(f"{path.relative_to(ROOT).as_posix()}::{name}")
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
    lines += [*words["actions"].splitlines(), *(_action(name, row, tests) for name, row in SAID["actions"].items()), ""]
    lines += ["## What is not covered", "", *[f"- {text}" for text in words["not_covered"]], "", *words["sora"].splitlines()]
    lines += [f"| {question} | {answer} |" for question, answer in SAID["sora"].items()]
    return "\n".join(lines) + "\n"


def _action(name: str, row: dict[str, str], tests: dict[str, list[str]]) -> str:
    cells = (
        name,
        row["controller"],
        row["unsafe"],
        ", ".join(row["hazards"].split()),
        row["constraint"],
        str(len(tests.get(name, []))),
    )
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    sys.stdout.write("\n".join(marked_tests().get(sys.argv[1], [])) + "\n" if sys.argv[1:] else page())
