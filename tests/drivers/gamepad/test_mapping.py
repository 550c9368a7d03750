"""Bytes of an input device to sticks and orders, by the shipped mapping of the thesis."""

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.base.orders import OperatorOrder, StickPositions
from companion.parts.gamepad.mapping_file import mapping_of
from drivers.gamepad import device
from drivers.gamepad.device import AXES, BUTTONS, EV_ABS, EV_KEY, EV_SYN, EVENT, SYN_DROPPED, AxisRange, InputEvent, events_in
from drivers.gamepad.mapping import GamepadMemory, gamepad_step, positions, start
from estimator.contracts.errors import BadInput
from estimator.contracts.time import MonoNs

THESIS = mapping_of("thesis")
RANGES = {AXES[name]: AxisRange(128, 0, 255) for name in ("ABS_X", "ABS_Y", "ABS_RX", "ABS_RY")}
MS = 1_000_000


def press(name: str, value: int = 1) -> InputEvent:
    return InputEvent(EV_KEY, BUTTONS[name], value)


def moved_stick(name: str, value: int) -> InputEvent:
    return InputEvent(EV_ABS, AXES[name], value)


def step(memory: GamepadMemory, *events: InputEvent, at_ms: int = 0) -> tuple[GamepadMemory, tuple[str, ...]]:
    return gamepad_step(THESIS, memory, events, RANGES, MonoNs(at_ms * MS))


def test_the_requests_are_the_kernels() -> None:
    """The numbers that the macros of linux/input.h give on 64-bit x86 and ARM; a wrong one is refused by every device."""
    assert device.eviocgname(256) == 0x81004506
    assert device.eviocgbit(0x01, 96) == 0x80604521
    assert device.eviocgbit(0x03, 8) == 0x80084523
    assert device.eviocgabs(0x00) == 0x80184540
    assert device.EVIOCSCLOCKID == 0x400445A0
    assert EVENT.size == 24


@pytest.mark.parametrize(
    ("axis", "value", "stick", "position"),
    [
        ("ABS_Y", 0, "climb", 1.0),
        ("ABS_Y", 255, "climb", -1.0),
        ("ABS_X", 255, "turn", 1.0),
        ("ABS_RY", 0, "forward", 1.0),
        ("ABS_RX", 0, "right", -1.0),
    ],
)
def test_the_sticks_are_those_of_the_thesis(axis: str, value: int, stick: str, position: float) -> None:
    memory, _ = step(start(THESIS, RANGES), moved_stick(axis, value))
    assert positions(THESIS, memory) == {**dict.fromkeys(("climb", "turn", "forward", "right"), 0.0), stick: position}


def test_the_buttons_are_those_of_the_thesis_and_every_order_is_one_of_the_arbiters() -> None:
    buttons = ["BTN_SOUTH", "BTN_EAST", "BTN_TR", "BTN_TL", "BTN_START"]
    _, orders = step(start(THESIS, RANGES), *map(press, buttons))
    assert orders == ("takeoff", "land", "emergency", "manual", "begin")
    assert {OperatorOrder(order) for order in THESIS.buttons.values()}


def test_orders_are_edges() -> None:
    memory = start(THESIS, RANGES)
    memory, orders = step(memory, press("BTN_EAST"), press("BTN_EAST", 2), press("BTN_EAST", 2), at_ms=0)
    assert orders == ("land",), "the kernel's repetition of a held button is none"
    memory, orders = step(memory, press("BTN_EAST", 0), press("BTN_EAST"), at_ms=30)
    assert orders == (), "a bounce is none"
    memory, orders = step(memory, press("BTN_EAST", 0), press("BTN_EAST"), at_ms=300)
    assert orders == ("land",)
    assert memory.bounced == 1
    many = ["BTN_SOUTH", "BTN_TL", "BTN_START", "BTN_NORTH", "BTN_WEST", "BTN_SELECT"]
    for n in range(30):
        memory, orders = step(memory, press(many[n % 6]), at_ms=400 + 20 * n)
    assert len(memory.given_at) == THESIS.orders_max_hz
    memory, orders = step(memory, press("BTN_SOUTH"), press("BTN_TR"), at_ms=995)
    assert orders == ("emergency",), "a person in panic presses everything"


def test_an_axis_that_was_never_near_its_centre_does_not_count() -> None:
    ranges = {code: AxisRange(0, 0, 255) for code in RANGES}
    memory = start(THESIS, ranges)
    assert set(positions(THESIS, memory).values()) == {0.0}, "some gamepads report an end until they are moved"
    memory, _ = step(memory, moved_stick("ABS_X", 0), moved_stick("ABS_RX", 128), moved_stick("ABS_RX", 255))
    assert positions(THESIS, memory) == {"climb": 0.0, "turn": 0.0, "forward": 0.0, "right": 1.0}


@given(st.lists(st.integers(-40_000, 40_000), min_size=2, max_size=20))
def test_a_stick_is_monotonic_bounded_and_centred_in_its_dead_zone(values: list[int]) -> None:
    found = []
    for value in sorted(values):
        memory, _ = step(start(THESIS, RANGES), moved_stick("ABS_X", value))
        found.append(positions(THESIS, memory)["turn"])
        StickPositions(turn=found[-1])
    assert all(a <= b for a, b in pairwise(found))
    assert positions(THESIS, step(start(THESIS, RANGES), moved_stick("ABS_X", 135))[0])["turn"] == 0.0


@given(st.lists(st.binary(max_size=100), max_size=8), st.integers(-3, 3), st.integers(-3, 300))
def test_no_bytes_of_a_device_raise(pieces: list[bytes], minimum: int, maximum: int) -> None:
    memory, rest = start(THESIS, RANGES), b""
    ranges = dict.fromkeys(RANGES, AxisRange(0, minimum, maximum))
    for n, piece in enumerate(pieces):
        events, rest = events_in(rest + piece)
        memory, orders = gamepad_step(THESIS, memory, events, ranges, MonoNs(n * MS))
        StickPositions(**positions(THESIS, memory))
        assert set(orders) <= set(THESIS.buttons.values())
    assert len(rest) < EVENT.size


@given(
    st.lists(
        st.builds(
            InputEvent,
            st.sampled_from([EV_SYN, EV_KEY, EV_ABS]),
            st.sampled_from([*AXES.values(), *BUTTONS.values(), SYN_DROPPED]),
            st.integers(-(2**31), 2**31 - 1),
        ),
        max_size=60,
    )
)
def test_no_events_raise_and_orders_are_bounded(events: list[InputEvent]) -> None:
    memory, orders = step(start(THESIS, RANGES), *events)
    StickPositions(**positions(THESIS, memory))
    assert len([order for order in orders if order != "emergency"]) <= THESIS.orders_max_hz


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ('dead_zone = 0.1|dead_zone = "wide"', 'dead_zone must be a number from 0.01 to 0.5, found "wide"'),
        ("dead_zone = 0.1|dead_zone = 0.9", "dead_zone must be a number from 0.01 to 0.5, found 0.9"),
        ("ABS_RX|ABS_RW", "there is no axis 'ABS_RW'; did you mean ABS_"),
        ("ABS_RX|ABS_X", "the axis ABS_X has two meanings"),
        ("BTN_SOUTH|BTN_SUOTH", "there is no button 'BTN_SUOTH'; did you mean BTN_SOUTH?"),
        ('"takeoff"|"jump"', "buttons.BTN_SOUTH must be one of takeoff, land"),
        ("limit = 1.0|limits = 1.0", "limit"),
        ("[sticks]|[stick]", "stick"),
        ("name = |name ", "not valid TOML"),
    ],
)
def test_a_wrong_file_is_refused_with_its_name_and_the_key(change: str, why: str, tmp_path: Path) -> None:
    shipped = (Path(__file__).parents[3] / "configs/gamepads/thesis.toml").read_text()
    before, _, after = change.partition("|")
    path = tmp_path / "mine.toml"
    path.write_text(shipped.replace(before, after, 1))
    with pytest.raises(BadInput) as refused:
        mapping_of(str(path))
    assert why in str(refused.value)
    assert "mine.toml" in str(refused.value)
    with pytest.raises(BadInput, match="no file"):
        mapping_of("thesys")
