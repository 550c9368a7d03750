"""Status texts of more than 50 characters, whole and with lost chunks."""

from hypothesis import given
from hypothesis import strategies as st

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.vehicle import CHUNK, LOST, JoinedTexts

PX4, COPTER = (1, 1), (2, 1)
REFUSAL = "Arming denied: Resolve system health failures first"


def chunks(text: str, number: int) -> list[Message]:
    """Return the chunks as an autopilot sends them: a full last chunk is followed by an empty one."""
    return [
        mav.MAVLink_statustext_message(2, text[k * CHUNK : (k + 1) * CHUNK].encode(), number, k)
        for k in range(len(text) // CHUNK + 1)
    ]


def joined(message: Message) -> Message:
    """Return the texts after a passage through the wire."""
    sender = mav.MAVLink(None, srcSystem=1, srcComponent=1)
    return mav.MAVLink(None).decode(bytearray(message.pack(sender)))


def test_a_refusal_of_51_characters_is_one_text() -> None:
    texts = JoinedTexts()
    first, second = (joined(m) for m in chunks(REFUSAL, 7))
    assert texts.on_message(first, PX4) == []
    assert texts.on_message(second, PX4) == [(2, REFUSAL)]


@given(st.lists(st.text("abcdefgh ", min_size=0, max_size=220), min_size=1, max_size=6))
def test_texts_of_two_senders_come_out_as_they_were(words: list[str]) -> None:
    texts, out = JoinedTexts(), []
    streams = [[joined(m) for n, w in enumerate(words, 1) for m in chunks(w, n)] for _ in (PX4, COPTER)]
    for pair in zip(*streams, strict=True):
        for sender, message in zip((PX4, COPTER), pair, strict=True):
            out += [(sender, text) for _, text in texts.on_message(message, sender)]
    for sender in (PX4, COPTER):
        assert [text for who, text in out if who == sender] == words


def test_a_lost_chunk_leaves_a_mark_and_costs_no_other_text() -> None:
    a, b, c = (joined(m) for m in chunks("x" * 50 + "y" * 50 + "z", 3))
    assert JoinedTexts().on_message(c, PX4) == [(2, f"{LOST}{LOST}z")]
    texts = JoinedTexts()
    texts.on_message(a, PX4)
    assert texts.on_message(c, PX4) == [(2, "x" * 50 + LOST + "z")]
    texts.on_message(a, PX4)
    texts.on_message(b, PX4)
    plain = joined(mav.MAVLink_statustext_message(6, b"armed"))
    assert texts.on_message(plain, PX4) == [(2, "x" * 50 + "y" * 50 + LOST), (6, "armed")]
    assert texts.on_message(plain, PX4) == [(6, "armed")]
