"""A transmitter's switch: what counts as moved, what never does, and the real messages over a link."""

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.orders import OperatorOrder
from companion.parts.mavlink.rc_switch import DEBOUNCE_S, RcSwitch, SwitchPosition, moved
from companion.settings.operator import SwitchOptions
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.rc_channels import BANDS_US
from tests.companion.mavlink.stage import US, bordered
from tests.make import ns

RECEIVER = int(mav.MAV_SYS_STATUS_SENSOR_RC_RECEIVER)
WIDTHS = [None, 0, 799, 1000, 1299, 1350, 1500, 1650, 1701, 2000, 2201, 65535]


def channels(pulse: int, *, count: int = 16, rssi: int = 255, throttle: int = 1100) -> Message:
    """Return RC_CHANNELS with this pulse on channel 7."""
    raw = [1500, 1500, throttle, 1500, 1500, 1500, pulse, *[1500] * 11]
    return mav.MAVLink_rc_channels_message(0, count, *raw, rssi)


@settings(max_examples=300)
@given(st.lists(st.tuples(st.sampled_from(WIDTHS), st.sampled_from([0.02, 0.1, 0.2, 0.35, 1.2]), st.integers(1, 6)), max_size=25))
def test_only_a_held_change_between_two_known_positions_is_a_move(spells: Any) -> None:
    memory, t, since_s, last = SwitchPosition(), 0.0, 0.0, -1
    for pulse, step_s, times in spells:
        for _ in range(times):
            t, before = t + step_s, memory.position
            memory, is_moved = moved(memory, pulse, ns(t))
            band = next((n for n, (least, most) in enumerate(BANDS_US) if least <= (pulse or 0) <= most), -1)
            last, since_s = band, since_s if band == last else t
            if is_moved:
                assert before not in (None, memory.position)
                assert memory.position == band
                assert t - since_s >= DEBOUNCE_S - 1e-6
                assert step_s <= 1.0, "a gap forgets"


async def test_the_real_messages_order_by_a_move_alone_and_never_by_what_is_lost() -> None:
    orders = list[OperatorOrder]()
    switch = RcSwitch(SwitchOptions(channel=7), lambda order, moved_at: orders.append(order))
    async with bordered() as border:
        border.autopilot.add_listener(lambda received: switch.on_message(border.autopilot, received))

        async def held(message: Message, *, well: bool = True) -> list[OperatorOrder]:
            """Send a message for longer than a switch must hold, then the receiver's state; return the orders by it."""
            orders.clear()
            began, health = border.clock.now(), RECEIVER if well else 0
            while border.clock.now() - began < 0.5e9:
                await border.send(message)
                await border.clock.sleep(0.05)
            await border.send(mav.MAVLink_sys_status_message(RECEIVER, RECEIVER, health, 0, 12000, -1, 80, 0, 0, 0, 0, 0, 0))
            return list(orders)

        assert await held(channels(2000)) == [], "it stands at begin when the service starts"
        for pulse, order in ((1000, OperatorOrder.HOLD), (2000, OperatorOrder.BEGIN), (1500, OperatorOrder.STAY)):
            assert await held(channels(pulse)) == [order]
        for lost in (channels(0), channels(65535), channels(2000, count=6), channels(2000, throttle=900)):
            assert await held(channels(1000)) in ([], [OperatorOrder.HOLD])
            assert await held(lost) == []
            assert await held(channels(2000)) == [], "the link that comes back begins nothing"
        assert await held(channels(1000, rssi=200)) == [OperatorOrder.HOLD]
        assert await held(channels(2000, rssi=200), well=False) == [], "a failsafe moved it"
        assert await held(channels(1000, rssi=0)) == await held(channels(2000, rssi=200)) == []
        asked = list[int]()
        while mav.MAVLINK_MSG_ID_RC_CHANNELS not in asked:
            for m in border.answers():
                if m.get_type() == "COMMAND_LONG" and m.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
                    asked.append(int(m.param1))
                    await border.send(mav.MAVLink_command_ack_message(m.command, 0, 0, 0, *US))
            await border.send(mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
            await border.clock.sleep(0.02)
