"""The state vector and its matrices are indexed by name: a number in a subscript would survive a change of layout unnoticed."""

import ast
from pathlib import Path

import pytest

from estimator.ekf import state

EKF = Path(state.__file__).parent
ALL_AXES = {"x": "all", "P": "all", "F": "all", "Q": "all", "g": "first", "H": "last", "J": "last"}
"""The names that hold the state, its matrices and Jacobians, and which axes of theirs run over the state."""


def raw_subscripts(source: str) -> list[str]:
    """Return "line: text" of each subscript that takes a component of the state by number."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Subscript):
            continue
        name = node.value.attr if isinstance(node.value, ast.Attribute) else getattr(node.value, "id", "")
        if name not in ALL_AXES:
            continue
        index = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        # A Jacobian without a second index is a choice of rows, which are components of the measurement.
        axes = {"all": index, "first": index[:1], "last": index[1:]}[ALL_AXES[name]]
        if any(isinstance(n, ast.Constant) and isinstance(n.value, int) for a in axes for n in _outside_names(a)):
            found.append(f"{node.lineno}: {ast.unparse(node)}")
    return found


def _outside_names(node: ast.AST) -> list[ast.AST]:
    """Return the nodes below this one, without the subscripts of other names (`x[DECK_RATE[2]]` names its part)."""
    if isinstance(node, ast.Subscript):
        return []
    return [node, *(below for child in ast.iter_child_nodes(node) for below in _outside_names(child))]


def uses_the_state(path: Path) -> bool:
    return path.name == "state.py" or "from estimator.ekf.state import" in path.read_text()


@pytest.mark.parametrize("path", sorted(filter(uses_the_state, EKF.glob("*.py"))), ids=lambda p: p.name)
def test_no_component_of_the_state_is_taken_by_number(path: Path) -> None:
    assert raw_subscripts(path.read_text()) == []


@pytest.mark.parametrize(
    "line",
    [
        "x[5]",
        "b.x[17]",
        "P[[3, 4, 5], [3, 4, 5]]",
        "P[3, 3]",
        "J[[0, 1], [16, 17]]",
        "x[3:6]",
        "F[3, SWAY]",
        "g[6, 0]",
        "x[6 + i]",
    ],
)
def test_the_search_finds_raw_numbers(line: str) -> None:
    assert raw_subscripts(line)


@pytest.mark.parametrize(
    "line", ["x[POS_DOWN]", "J[:3, POS_REL]", "x[DECK_RATE[2]]", "J[6, PAD_YAW]", "g[VEL_NORTH, 0]", "H[:3]"]
)
def test_the_search_leaves_names_alone(line: str) -> None:
    assert raw_subscripts(line) == []


def test_names_of_components_agree_with_their_slices() -> None:
    components = range(state.N)
    assert components[state.ATT_ERR] == state.ATT_AXES
    assert components[state.POS_REL] == state.POS_AXES
    assert components[state.VEL] == state.VEL_AXES
    assert list(components[state.POS_HORIZONTAL]) == [state.POS_NORTH, state.POS_EAST]
    assert list(components[state.VESSEL_VEL]) == [state.VESSEL_NORTH, state.VESSEL_EAST]
