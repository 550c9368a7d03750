"""Write docs/safety.md: hazards by STPA, each with its constraint, its marked tests and the command that measures it.

`python -m supply.safety` prints the page. A test that shows a hazard's constraint carries `@pytest.mark.hazard("H1")`.
Source of the method: N. Leveson and J. Thomas, STPA Handbook, 2018, chapter 2.
"""

import ast
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True, slots=True)
class Hazard:
    """One hazardous state of the system, and what keeps the product out of it."""

    name: str
    losses: str
    """Numbers of the losses that it leads to."""
    unsafe: str
    """Control actions that bring it about: provided, not provided, at the wrong time, or for too long."""
    constraint: str
    figure: str
    """Command that measures the constraint, or the page with its numbers."""


LOSSES = {
    "L1": "a person is injured",
    "L2": "the drone is lost or damaged: water, deck, structure",
    "L3": "the ship or its equipment is damaged",
    "L4": "a person acts on a wrong picture of the flight",
}
HAZARDS = {
    "H1": Hazard(
        "The drone descends without knowing where the pad is",
        "L1 L2 L3",
        "descend is provided while the estimate is old, inconsistent or from one lying sensor",
        "No descent command without a fresh, consistent estimate; whatever fails stops the descent.",
        "`decklander campaign sea_state_4 --faults random --runs 100 --perception model`",
    ),
    "H2": Hazard(
        "The drone descends to something that is not its pad",
        "L1 L2 L3",
        "descend is provided for a false pad or another pad",
        "A pose is used above a confidence that clutter reaches less than once in 10,000 frames; a second pad is "
        "a person's decision.",
        "`python -m benches.false_pads`, `decklander pad check FILE`",
    ),
    "H3": Hazard(
        "The drone touches the deck too fast, tilted or beside the pad",
        "L2 L3",
        "commit is provided outside its limits, or go around is not provided when they are left",
        "The gate and the commit ask for the error, speed and tilt that the contact will have; a deck or wind "
        "beyond them is waited for.",
        "`decklander campaign weather_4 --runs 100 --perception model`",
    ),
    "H4": Hazard(
        "Motors turn on a deck where the drone stands, or stop in the air",
        "L1 L2",
        "stop is provided without a contact, too late after it, or not at all",
        "Motors stop by an agreement of contact witnesses or by a person's confirmed order, and the order is "
        "repeated until it is obeyed.",
        "`armed_after_contact_s` of `decklander simulate SCENARIO --autopilot arducopter --json`",
    ),
    "H5": Hazard(
        "A command outlives the service that gave it",
        "L1 L2 L3",
        "any velocity is applied for too long: crash, kill, blocked loop, stalled link",
        "Silence of ours becomes a hover within the stated time; what arrives late is dropped.",
        "`python -m benches.dead_man`, `python -m benches.killed`",
    ),
    "H6": Hazard(
        "A person cannot take the drone",
        "L1 L2 L3",
        "guidance commands after a person took the hand, or a person's order is not carried out",
        "A person's order wins over guidance in every state and from every door; an abort stays until a person begins again.",
        "[operator.md](operator.md)",
    ),
    "H7": Hazard(
        "The drone leaves the space that it may use",
        "L1 L2",
        "a velocity leads out of the fence, above the height limit, or climbs without end by a lying sensor",
        "Fence, heights and time budgets bound every velocity of guidance and of people, and never make the drone descend.",
        "`decklander campaign thirty_faults`",
    ),
    "H8": Hazard(
        "Somebody else's vehicle is commanded, or somebody else commands",
        "L1 L2 L3",
        "a command goes to another autopilot, or comes from a peer without the right",
        "One place decides who is the autopilot; while it is not clear nothing is commanded. Orders need their "
        "key, token or local user.",
        "[security.md](security.md)",
    ),
    "H9": Hazard(
        "A person is shown a wrong state",
        "L4",
        "feedback is missing, late or of another time",
        "State, holder and cause are reported within 0.2 s, with the age of what is shown; a link that is lost says so.",
        "[page.md](page.md)",
    ),
    "H10": Hazard(
        "The energy ends over water",
        "L2",
        "hold or search is applied for too long",
        "Every wait and every try has a budget; a low battery stops take-offs and is reported.",
        "[mission.md](mission.md)",
    ),
    "H11": Hazard(
        "Something around the flight stops it",
        "L2",
        "commands stop because of a disk, broker, terminal, page or log",
        "The event loop waits for nobody; parts that fail are set aside and the flight goes on.",
        "`python -m benches.chaos`",
    ),
    "H12": Hazard(
        "The set-up is wrong and nobody knows",
        "L2 L4",
        "descend is provided with a wrong lens, mount, delay or parameter",
        "Calibration states what it does not know; `doctor` and the first seconds of flight compare each sensor with another.",
        "`python -m benches.calibration`",
    ),
}
NOT_COVERED = (
    "Mechanical failures: a rotor, motor, frame or battery that breaks. The autopilot and the person deal with them.",
    "Masts, wires and other aircraft on the way to the deck: keep the approach clear.",
    "GNSS interference, as far as the autopilot's own hold depends on it.",
    "Ice, salt and water in the drone.",
    "Real decks: all figures come from simulation, recordings of others and photographs ([limits.md](limits.md)).",
)
SORA = {
    "Containment (step 8)": "a fence of any polygon around the start or the ship, height limits, and a radius of return "
    "([configuration.md](configuration.md)); "
    "tests of H7. The product is no independent containment: use the autopilot's own fence beside it.",
    "Command and control link (OSO 6)": "what each lost link leads to, and after which time: [limits.md](limits.md), "
    "[mavlink.md](mavlink.md); tests of H5 and H11.",
    "Protection from human error (OSO 18, 19)": "orders are judged by one table of situations; dangerous ones need a "
    "confirmation "
    "([operator.md](operator.md)); tests of H6.",
    "Human-machine interface (OSO 20)": "one page with state, cause, error and delay ([page.md](page.md)); tests of H9. No "
    "study with operators was made.",
    "Weather (OSO 23, 24)": "what lands, by wind and sea, for a vehicle: `decklander campaign --map`; tests of H3. The drone's "
    "own rating is its maker's.",
    "Procedures, training, maintenance (OSO 1 to 4, 7 to 9)": "yours; [first-hour.md](first-hour.md) "
    "and `decklander doctor` are material for them.",
    "Ground risk (steps 2, 3)": "yours: mass, speed and who is on deck. The product flies to a pad that it sees and does not "
    "descend without it.",
}


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
        "Losses: " + "; ".join(f"{name} {text}" for name, text in LOSSES.items()) + ".",
        "",
        "The controller is guidance, or the person who has the hand. Its actions are: descend, commit, go around, "
        "hold, stop the motors, hand over. Its feedback is",
        "the estimate of the pad, the contact witnesses, the vehicle's own state and the orders of people.",
        "",
    ]
    for name, hazard in HAZARDS.items():
        lines += [
            f"## {name}: {hazard.name}",
            "",
            f"- Losses: {', '.join(hazard.losses.split())}. Unsafe: {hazard.unsafe}.",
            f"- Constraint: {hazard.constraint}",
            f"- Measured by: {hazard.figure}",
            "- Tests:",
            *[f"    - `{test}`" for test in tests.get(name, [])],
            "",
        ]
    lines += ["## What is not covered", "", *[f"- {text}" for text in NOT_COVERED], ""]
    lines += [
        "## Questions of SORA to an operator",
        "",
        "The steps and objectives are those of JARUS SORA 2.5.",
        "",
        "| question | what the product answers |",
        "|---|---|",
    ]
    lines += [f"| {question} | {answer} |" for question, answer in SORA.items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(page())
