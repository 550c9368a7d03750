import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ardrone import at
from drivers.ardrone.counters import Refusal
from tests.drivers.captures import CAPTURES, needs_captures

f32 = st.floats(allow_nan=False, allow_infinity=False, width=32)
i32 = st.integers(-(2**31), 2**32 - 1)
text = st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters='"'), max_size=30)
commands = st.one_of(
    st.builds(at.Ref, i32), st.builds(at.Pcmd, i32, f32, f32, f32, f32), st.builds(at.PcmdMag, i32, f32, f32, f32, f32, f32, f32),
    st.just(at.Ftrim()), st.builds(at.Calib, i32), st.builds(at.Config, text, text), st.builds(at.ConfigIds, text, text, text),
    st.builds(at.Ctrl, i32, st.none() | i32), st.just(at.ComWdg()), st.builds(at.Led, i32, f32, i32),
    st.builds(at.Pmode, i32), st.builds(at.Misc, i32, i32, i32, i32), st.builds(at.Anim, i32, i32),
)  # fmt: skip
sequences = st.integers(0, 2**32 - 1)


@needs_captures
def test_a_real_session_parses_and_encodes_to_its_own_bytes() -> None:
    log = (CAPTURES / "at_commands_takeoff_land_ardrone1.txt").read_bytes()
    results = at.decode(log)
    assert len(results) == 609
    assert [r for r in results if isinstance(r, Refusal)] == []
    encoded = b"".join(at.encode(*r) for r in results if not isinstance(r, Refusal))
    assert encoded.replace(b"\r", b"\n") == log
    refs = [c for r in results if not isinstance(r, Refusal) for c in r[1:] if isinstance(c, at.Ref)]
    assert any(c.take_off for c in refs)
    assert not refs[0].take_off


@pytest.mark.parametrize(
    ("command", "line"),
    [
        (at.Ref(at.REF_BASE), b"AT*REF=7,290717696\r"),
        (at.Ref(at.REF_BASE | at.REF_TAKE_OFF), b"AT*REF=7,290718208\r"),
        (at.Ref(at.REF_BASE | at.REF_EMERGENCY), b"AT*REF=7,290717952\r"),
        (at.Pcmd(1, -0.8, 0.05, 0.0, -0.0), b"AT*PCMD=7,1,-1085485875,1028443341,0,-2147483648\r"),
        (at.PcmdMag(5, 0.5, 0.25, 1.0, -1.0, 0.125, 2.0),
         b"AT*PCMD_MAG=7,5,1056964608,1048576000,1065353216,-1082130432,1040187392,1073741824\r"),
        (at.Config("general:navdata_demo", "FALSE"), b'AT*CONFIG=7,"general:navdata_demo","FALSE"\r'),
        (at.Config("leds:leds_anim", "3,1073741824,2"), b'AT*CONFIG=7,"leds:leds_anim","3,1073741824,2"\r'),
        (at.ConfigIds("a", "b", "c"), b'AT*CONFIG_IDS=7,"a","b","c"\r'),
        (at.Ctrl(5), b"AT*CTRL=7,5,0\r"),
        (at.Ctrl(0, None), b"AT*CTRL=7,0\r"),
        (at.ComWdg(), b"AT*COMWDG=7\r"),
        (at.Ftrim(), b"AT*FTRIM=7\r"),
        (at.Calib(0), b"AT*CALIB=7,0\r"),
        (at.Led(3, 2.0, 5), b"AT*LED=7,3,1073741824,5\r"),
        (at.Anim(16, 15), b"AT*ANIM=7,16,15\r"),
        (at.Pmode(2), b"AT*PMODE=7,2\r"),
        (at.Misc(), b"AT*MISC=7,2,20,2000,3000\r"),
    ],
)  # fmt: skip
def test_bytes_of_each_command(command: at.AtCommand, line: bytes) -> None:
    assert at.encode(7, command) == line
    (back,) = at.decode(line)
    assert not isinstance(back, Refusal)
    assert at.encode(*back) == line


@settings(max_examples=300)
@given(st.lists(st.tuples(sequences, commands), max_size=6))
def test_what_is_encoded_decodes(told: list[tuple[int, at.AtCommand]]) -> None:
    assert at.decode(b"".join(at.encode(*t) for t in told)) == told


@settings(max_examples=300)
@given(st.binary(max_size=200), st.binary(max_size=50))
def test_garbage_never_raises_and_never_costs_the_next_command(garbage: bytes, behind: bytes) -> None:
    good = at.encode(9, at.Config("a:b", "c"))
    assert (9, at.Config("a:b", "c")) in at.decode(garbage + good + behind)
    assert (9, at.Config("a:b", "c")) in at.decode(garbage + b"\r" + good + behind)


def test_a_datagram_cut_at_every_byte_keeps_its_whole_commands() -> None:
    reported: list[tuple[int, Any]] = [
        (1, at.Ref(at.REF_BASE)),
        (2, at.Config("video:video_channel", "1")),
        (3, at.Pcmd(1, 0.5, 0.25, -0.125, 1.0)),
    ]
    lines = [at.encode(*t) for t in reported]
    data = b"".join(lines)
    for cut in range(len(data) + 1):
        whole = sum(len(b"".join(lines[: k + 1])) <= cut for k in range(3))
        results = at.decode(data[:cut])
        assert results[:whole] == reported[:whole]
        assert results[whole:] == ([Refusal.TORN] if cut > len(b"".join(lines[:whole])) else [])
        tail = at.decode(data[cut:])
        starts = [len(b"".join(lines[:k])) for k in range(3)]
        assert [r for r in tail if not isinstance(r, Refusal)] == [t for t, s in zip(reported, starts, strict=True) if s >= cut]


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"hello\r", Refusal.BAD_MAGIC), (b"AT*NOSUCH=1,2\r", Refusal.UNKNOWN_COMMAND), (b"AT*REF=1\r", Refusal.BAD_ARGUMENTS),
        (b"AT*REF=1,2,3\r", Refusal.BAD_ARGUMENTS), (b"AT*REF=1,x\r", Refusal.BAD_ARGUMENTS),
        (b"AT*REF=x,1\r", Refusal.BAD_ARGUMENTS),
        (b"AT*REF=1,99999999999\r", Refusal.BAD_ARGUMENTS), (b"AT*REF=1,5000000000\r", Refusal.BAD_ARGUMENTS),
        (b"AT*REF=9999999999,1\r", Refusal.BAD_ARGUMENTS), (b"AT*FTRIM=1,\r", Refusal.BAD_ARGUMENTS),
        (b"AT*PCMD=1,1,0,0,0,2139095040\r", Refusal.BAD_ARGUMENTS), (b'AT*CONFIG=1,"a"x,"b"\r', Refusal.BAD_ARGUMENTS),
        (b'AT*CONFIG=1,a,"b"\r', Refusal.BAD_ARGUMENTS), (b'AT*CONFIG=1,"a","\xff"\r', Refusal.BAD_ARGUMENTS),
        (b"AT*COMWDG=1", Refusal.TORN),
    ],
)  # fmt: skip
def test_reasons_of_refusal(line: bytes, why: Refusal) -> None:
    assert at.decode(line) == [why]


@pytest.mark.parametrize(
    "command",
    [
        at.Pcmd(1, math.nan, 0.0, 0.0, 0.0), at.Pcmd(1, 1e39, 0.0, 0.0, 0.0), at.Config('a"b', "c"), at.Config("a", "b\r"),
        at.Config("é", ""), at.Ref(2**32),
    ],
)  # fmt: skip
def test_what_cannot_travel_is_our_mistake(command: at.AtCommand) -> None:
    with pytest.raises(ValueError, match=type(command).__name__.upper()[:3] + "|float"):
        at.encode(1, command)


def test_sequence_rule_of_the_receiver() -> None:
    gate = at.SequenceGate()
    assert [gate.accepts(n) for n in (1, 2, 5, 5, 4, 6, 1, 2, 2)] == [True, True, True, False, False, True, True, True, False]
    gate.accepts(100)
    gate.reset()
    assert gate.accepts(3)
