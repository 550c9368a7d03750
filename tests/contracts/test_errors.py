"""The text of an error is one printable line, whatever bytes from outside came into it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.contracts.errors import BadInput, DecklanderError, Recoverable, SetupImpossible


@pytest.mark.parametrize("kind", [BadInput, Recoverable, SetupImpossible])
@given(text=st.text())
def test_a_text_is_one_printable_line(kind: type[DecklanderError], text: str) -> None:
    output = str(kind(text))
    assert output.isprintable()
    assert output == text or not text.isprintable()


def test_a_line_break_becomes_a_space_and_an_escape_sequence_is_shown() -> None:
    assert str(BadInput("log.bin: format '\n' of \x1b[31mIMU, 3 µs, 0.5°")) == r"log.bin: format ' ' of \x1b[31mIMU, 3 µs, 0.5°"
