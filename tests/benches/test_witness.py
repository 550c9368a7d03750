"""Rows of the tables in which the simulator stands beside the physics of others."""

import pytest

from benches.witness.contact import CASES, Case, Ours, Theirs, agree, landing, of_friction


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_contact_is_as_in_mujoco(case: Case) -> None:
    pytest.importorskip("mujoco", reason="the extra witness is not installed")
    f = of_friction(0.4)
    assert agree(landing(Ours(f, case)), landing(Theirs(f, case)))
