"""Write docs/safety.md: hazards by STPA (safety.toml), each with its constraint, marked tests and the command that measures it.

`python -m supply.safety` prints the page. A test that shows a hazard's constraint carries `@pytest.mark.hazard("H1")`.
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
    tests = marked_tests()
    lines = [
        "# Safety case",
        "",
        "Hazards of a drone over a deck, found by STPA (system-theoretic process analysis), and what keeps the "
        "product out of each. `python -m supply.safety`",
        "writes this page from the marks of the tests; a hazard without a test fails the tests of the "
        "documentation. It is no certificate.",
        "",
        "Losses: " + "; ".join(f"{name} {text}" for name, text in SAID["losses"].items()) + ".",
        "",
        "The controller is guidance, or the person who has the hand. Its actions are: descend, commit, go around, "
        "hold, stop the motors, hand over. Its feedback is",
        "the estimate of the pad, the contact witnesses, the vehicle's own state and the orders of people.",
        "",
    ]
    for name, hazard in SAID["hazards"].items():
        lines += [
            f"## {name}: {hazard['name']}",
            "",
            f"- Losses: {', '.join(hazard['losses'].split())}. Unsafe: {hazard['unsafe']}.",
            f"- Constraint: {hazard['constraint']}",
            f"- Measured by: {hazard['figure']}",
            "- Tests:",
            *[f"    - `{test}`" for test in tests.get(name, [])],
            "",
        ]
    lines += ["## What is not covered", "", *[f"- {text}" for text in SAID["words"]["not_covered"]], ""]
    lines += [
        "## Questions of SORA to an operator",
        "",
        "The steps and objectives are those of JARUS SORA 2.5.",
        "",
        "| question | what the product answers |",
        "|---|---|",
    ]
    lines += [f"| {question} | {answer} |" for question, answer in SAID["sora"].items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(page())
