import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.ardrone import control
from tests.drivers.captures import CAPTURES, needs_captures

words = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=12)
keys = st.from_regex(r"[a-z_]{1,10}:[a-z0-9_]{1,20}", fullmatch=True)
values = st.lists(words, max_size=4).map(" ".join)


@needs_captures
def test_a_real_configuration() -> None:
    text = (CAPTURES / "config_port5559_ardrone1.txt").read_bytes()
    reported = control.parse(text)
    assert len(reported) == len([line for line in text.splitlines() if b"=" in line])
    assert reported["general:navdata_options"] == "65537"
    assert reported["general:soft_build_date"] == "2011-07-13 09:52"
    assert reported["network:passkey"] == ""
    assert reported["network:owner_mac"] == "00:00:00:00:00:00"
    assert control.boolean(reported["general:navdata_demo"]) is True
    assert control.vector(reported["control:accs_offset"]) == (-2235.3198, 1924.7540, 2084.4270)
    assert control.number(reported["control:euler_angle_max"]) == pytest.approx(0.15)
    assert control.render(reported).rstrip(b"\0").split() == text.split()


@given(st.dictionaries(keys, values, max_size=8))
def test_what_is_rendered_parses(configuration: dict[str, str]) -> None:
    data = control.render(configuration)
    assert data.endswith(control.END)
    assert control.parse(data) == configuration
    assert control.parse(data + b"general:late = 1\n") == configuration, "what follows the NUL is not of this text"


@given(st.binary(max_size=300))
def test_garbage_never_raises_and_costs_no_line(garbage: bytes) -> None:
    control.parse(garbage)
    reported = control.parse(garbage.replace(b"\0", b"") + b"\ngeneral:a = 1\n")
    assert reported["general:a"] == "1"


def test_values() -> None:
    assert control.boolean("perhaps") is None
    assert control.number("nan") is None
    assert control.number("x") is None
    assert control.vector("1 2") is None
    assert control.vector("{ 1 x }") is None
    assert control.vector(control.format_vector((1.5, -2.0))) == (1.5, -2.0)
    assert control.boolean("FALSE") is False
