"""Origin of messages: autopilots of one id behind a router, one that boots, late, doubled and lost messages."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.roster import Origins
from estimator.contracts.time import NS_PER_S, MonoNs

# A case of some seconds of messages is not made smaller: its numbers say enough.
BRIEF = settings(max_examples=25, deadline=None, phases=(Phase.explicit, Phase.reuse, Phase.generate))


@dataclass
class Craft:
    """An autopilot that sends a heartbeat each second, an attitude 50 times and its landed state 5 times a second."""

    booted_s: float
    """Time since boot at our time 0, s."""
    landed: bool = False
    begins_s: float = 0.0
    ends_s: float = 1e9
    sequence: int = 0

    def messages(self, seconds: float) -> list[tuple[float, bytes]]:
        codec, out = Codec(1, 1, datagrams=True), []
        codec._spoken[1] = self.sequence
        for n in range(round(self.begins_s * 50), round(min(self.ends_s, seconds) * 50)):
            t = n / 50.0
            boot_ms = round(1000 * (t + self.booted_s))
            batch = [mav.MAVLink_attitude_quaternion_message(boot_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)]
            if n % 50 == round(self.begins_s * 50) % 50:
                batch.insert(0, mav.MAVLink_heartbeat_message(2, 3, 0 if self.landed else 128, 5, 3 if self.landed else 4, 3))
            if n % 10 == 0:
                batch.append(mav.MAVLink_extended_sys_state_message(0, 1 if self.landed else 2))
            out += [(t, codec.pack(message)) for message in batch]
        return out


def passed(origins: Origins, wire: list[tuple[float, bytes]], seconds: float) -> list[tuple[float, Message]]:
    """Return the messages that are passed on, with their times; waiting ones are polled as the service does."""
    codec, out = Codec(255, 1, datagrams=True), []
    ticks = [(n * 0.04, b"") for n in range(round(seconds / 0.04))]
    for t, data in sorted(wire + ticks, key=lambda one: one[0]):
        at = MonoNs(round((1000.0 + t) * NS_PER_S))
        messages = [m for got in codec.feed(data) for m in origins.sort(got, at)] if data else origins.due(at)
        out += [(t, m) for m in messages]
    return out


def kinds(messages: list[tuple[float, Message]]) -> list[str]:
    return [m.get_type() for _, m in messages]


@BRIEF
@given(
    other_s=st.floats(2.0, 4e6) | st.floats(-90.0, -2.0),
    begins_s=st.floats(0.5, 3.0),
    sequence=st.integers(0, 255),
    seed=st.integers(0, 99),
    loss=st.floats(0.0, 0.1),
)
def test_of_two_autopilots_with_one_id_only_the_first_is_passed(other_s, begins_s, sequence, seed, loss):
    flying = Craft(100.0)
    standing = Craft(100.0 + other_s, landed=True, begins_s=begins_s, sequence=sequence)
    rng, origins, seconds = np.random.default_rng(seed), Origins(), 6.0
    wire = [one for craft in (flying, standing) for one in craft.messages(seconds) if rng.random() >= loss]
    out = passed(origins, wire, seconds)
    boots_s = [1e-3 * m.time_boot_ms - t for t, m in out if m.get_type() == "ATTITUDE_QUATERNION"]
    assert np.allclose(boots_s, 100.0, atol=0.01)
    assert len(boots_s) > (1.0 - loss) * 45 * seconds
    # Its first HEARTBEAT may come with a count that continues the other's by chance; its landed state comes behind a time.
    assert all(m.landed_state == 2 for _, m in out if m.get_type() == "EXTENDED_SYS_STATE")
    assert sum(m.system_status == 3 for _, m in out if m.get_type() == "HEARTBEAT") <= 1
    assert origins.several(MonoNs(round(1006.0 * NS_PER_S)))
    assert origins.changes == 0


@pytest.mark.parametrize("gap_s", [0.0, 4.0, 30.0])
def test_one_that_boots_is_the_same_one(gap_s: float) -> None:
    origins, seconds = Origins(), 10.0 + gap_s
    wire = Craft(500.0, ends_s=3.0).messages(seconds) + Craft(-3.0 - gap_s + 2.0, begins_s=3.0 + gap_s).messages(seconds)
    out = passed(origins, wire, seconds)
    assert origins.changes == 1
    assert not origins.several(MonoNs(round((1000.0 + seconds) * NS_PER_S)))
    after = [t for t, m in out if m.get_type() == "ATTITUDE_QUATERNION" and t >= 3.0 + gap_s]
    assert after[0] <= 3.0 + gap_s + (1.1 if gap_s < 1.0 else 0.1)
    assert "HEARTBEAT" in kinds([one for one in out if one[0] >= 3.0 + gap_s])


def test_one_that_takes_the_others_place_is_accepted_late() -> None:
    """The followed one of two autopilots is switched off; the other one is no reboot of it."""
    origins = Origins()
    wire = Craft(100.0, ends_s=5.0).messages(20.0) + Craft(700.0, landed=True, begins_s=1.0).messages(20.0)
    out = passed(origins, wire, 20.0)
    taken = [t for t, m in out if m.get_type() == "ATTITUDE_QUATERNION" and m.time_boot_ms > 600_000]
    assert 14.9 < taken[0] < 15.2
    assert origins.changes == 1


@BRIEF
@given(seed=st.integers(0, 999), loss=st.floats(0.0, 0.2), late_s=st.floats(0.0, 0.1), doubled=st.booleans())
def test_one_alone_is_passed_whatever_the_network_does(seed: int, loss: float, late_s: float, doubled: bool) -> None:
    rng, origins, seconds = np.random.default_rng(seed), Origins(), 4.0
    sent = [one for one in Craft(50.0, sequence=250).messages(seconds) if rng.random() >= loss]
    wire = [(t + late_s * rng.random(), data) for t, data in sent]
    if doubled:
        wire += [(t + 2.5, data) for t, data in sent]  # by a second path that is slow
    out = passed(origins, wire, seconds + 8.0)
    assert {
        m.get_msgbuf()[4:].tobytes() if hasattr(m.get_msgbuf(), "tobytes") else bytes(m.get_msgbuf()[4:]) for _, m in out
    } == {data[4:] for _, data in sent}
    assert not origins.several(MonoNs(round((1000.0 + seconds) * NS_PER_S)))
    assert origins.changes == 0


def test_values_that_are_made_up_are_no_second_autopilot() -> None:
    origins, codec = Origins(), Codec(1, 1, datagrams=True)
    garbage = []
    for n in range(300):
        boot_ms = (0, 1, 2**31, 2**32 - 1, n * 7_919_317 % 2**32)[n % 5]
        garbage.append((3.0 + n / 100.0, codec.pack(mav.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))))
    out = passed(origins, Craft(100.0).messages(8.0) + garbage, 8.0)
    assert not origins.several(MonoNs(round(1008.0 * NS_PER_S)))
    assert sum(kind == "ATTITUDE_QUATERNION" for kind in kinds(out)) == 400


def test_heartbeats_alone_tell_a_second_autopilot() -> None:
    """One without requests sends no times: its HEARTBEATs count on their own, and lost messages clear nothing."""
    codec, origins, beats = Codec(1, 1, datagrams=True), Origins(), []
    codec._spoken[1] = 77
    for n in range(6):
        codec._spoken[1] += 20 if n == 5 else 0
        beats.append((2.0 + n, codec.pack(mav.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3))))
    out = passed(origins, Craft(100.0).messages(8.0) + beats, 8.0)
    assert sum(m.system_status == 3 for _, m in out if m.get_type() == "HEARTBEAT") <= 1
    assert origins.several(MonoNs(round(1008.0 * NS_PER_S)))
    assert not origins.several(MonoNs(round(1020.0 * NS_PER_S)))
