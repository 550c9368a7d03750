"""The bench of the thesis' page names a number that moved, and not one that trembles."""

from benches.thesis import moved


def test_a_line_of_the_page_that_moved_is_named() -> None:
    row = "| best | 0.1 to 5.1 m | 91 % | {} |"
    assert moved(row.format(0.6), row.format(1.4)) == []
    assert moved(row.format(0.6), row.format(1619.3)) == [f"{row.format(0.6)}\n    is now {row.format(1619.3)}"]
    assert len(moved(row.format(0.6), row.format("-"))) == 1
    assert len(moved(row.format(0.6), "")) == 1
