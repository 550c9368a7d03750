"""The safety case is generated: each hazard has tests that carry its mark, and the page is that of the marks."""

from supply.safety import HAZARDS, LOSSES, ROOT, marked_tests, page


def test_every_hazard_has_a_test_and_every_mark_a_hazard() -> None:
    assert sorted(marked_tests()) == sorted(HAZARDS)
    assert {loss for hazard in HAZARDS.values() for loss in hazard.losses.split()} == set(LOSSES)


def test_the_page_is_that_of_the_marks() -> None:
    assert (ROOT / "docs/safety.md").read_text() == page(), "python -m supply.safety > docs/safety.md"
