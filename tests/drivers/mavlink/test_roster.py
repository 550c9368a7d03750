"""Choice of the autopilot, with the setting that resolves each conflict; origin of messages behind a router."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.roster import FIRST_S, MOVED_S, Bound, Origins, Roster
from estimator.contracts.time import NS_PER_S, MonoNs
from tests.make import ns

OURS = (1, 191)
SEVEN = Bound(7, silent_s=0.1, lost=False, commanded=False, several=False)


def beat(
    system: int, seconds: float, *, flies: bool = False, component: int = 1, kind: int = 2, mode: int = 5
) -> ReceivedMessage:
    message = mav.MAVLink_heartbeat_message(kind, 3, 129 if flies else 1, mode, 4 if flies else 3, 3)
    return ReceivedMessage(message, 0, ns(seconds), system, component, ("10.0.0.2", 14550 + system))


def roster_of(system_id: int = 0, vessel_id: int = 0) -> Roster:
    return Roster(AutopilotOptions("udpin://127.0.0.1:14550", system_id=system_id, vessel_id=vessel_id))


def receive(roster: Roster, until_s: float, *flying: int, since_s: float = 0.0, systems: tuple[int, ...] = (1, 7)) -> None:
    for second in range(round(since_s), round(until_s) + 1):
        for system in systems:
            roster.on_heartbeat(beat(system, float(second), flies=system in flying))


def roster_names(roster: Roster, bound: Bound | None, seconds: float) -> dict[str, bool]:
    return {one.name: one.blocks for one in roster.conflicts(bound, OURS, ns(seconds))}


@pytest.mark.hazard("H8")
@pytest.mark.parametrize("flying", [(), (1, 7)])
def test_of_two_that_fly_or_stand_nobody_is_commanded(flying: tuple[int, ...]) -> None:
    roster = roster_of()
    receive(roster, 3.0, *flying)
    (conflict,) = roster.conflicts(SEVEN, OURS, ns(3.0))
    assert conflict.blocks
    assert "system 1 " in conflict.what
    assert "system 7 " in conflict.what
    assert "vehicle.system_id (1 or 7)" in conflict.fix
    assert not roster.chosen(1, SEVEN, ns(3.0))
    assert roster_names(roster, SEVEN, 9.0) == {}, "the others are gone"


def test_the_first_that_flies_is_meant_and_not_the_first_that_is_received() -> None:
    roster = roster_of()
    assert roster.chosen(7, None, ns(0.0)), "one that is heard is listened to"
    receive(roster, 2.0, 1)
    assert roster.chosen(1, SEVEN, ns(2.0))
    one = replace(SEVEN, system=1)
    assert roster_names(roster, one, 2.0) == {"several-autopilots": False}
    receive(roster, 2.0 + FIRST_S, 1, since_s=3.0)
    receive(roster, 12.0, 1, 7, since_s=8.0)
    assert roster_names(roster, one, 12.0) == {"several-autopilots": False}, "the second to fly changes nothing"
    assert not roster.chosen(7, one, ns(12.0))
    receive(roster, 16.0, 7, since_s=13.0)
    assert not roster.chosen(7, one, ns(16.0)), "nor that the first has landed"


def test_one_that_follows_our_commands_stays_the_one_that_is_meant() -> None:
    roster = roster_of()
    flown = replace(SEVEN, commanded=True)
    roster.commanded(7)
    receive(roster, 3.0, 1, 7)
    assert roster_names(roster, flown, 3.0) == {"several-autopilots": False}
    receive(roster, 30.0, 1, since_s=4.0, systems=(1,))
    silent = replace(flown, lost=True, silent_s=27.0)
    assert not roster.chosen(1, silent, ns(30.0))
    (conflict,) = roster.conflicts(silent, OURS, ns(30.0))
    assert "vehicle.system_id (1)" in conflict.fix


def test_another_id_is_taken_when_the_autopilot_has_been_silent() -> None:
    roster = roster_of()
    receive(roster, 20.0, systems=(1,))
    early = replace(SEVEN, lost=True, silent_s=4.0)
    late = replace(early, silent_s=3.0 + MOVED_S + 0.1)
    assert not roster.chosen(1, early, ns(20.0))
    assert roster.chosen(1, late, ns(20.0))
    assert roster_names(roster, late, 20.0) == {"autopilot-id-changed": True}
    roster.on_heartbeat(beat(3, 20.0))
    assert not roster.chosen(1, late, ns(20.0)), "which of the two is its new id?"


@pytest.mark.hazard("H8")
def test_two_of_one_id_are_named_and_nobody_is_commanded() -> None:
    roster = roster_of(system_id=7)
    (conflict,) = roster.conflicts(replace(SEVEN, several=True), OURS, ns(0.0))
    assert (conflict.name, conflict.blocks) == ("autopilot-id-twice", True)
    assert "system 7" in conflict.what
    for seconds, uid in ((0.0, 0xAB), (0.0, 0xCD), (1.0, 0xAB)):
        roster.note_uid(uid, ns(seconds))
    assert roster_names(roster, SEVEN, 1.0) == {}, "one odd answer is none"
    roster.note_uid(0xCD, ns(3.0))
    (conflict,) = roster.conflicts(SEVEN, OURS, ns(3.0))
    assert "ab and cd" in conflict.what
    assert roster_names(roster, SEVEN, 30.0) == {}


def test_one_of_our_autopilots_id_elsewhere_is_named_when_it_does_other_things() -> None:
    roster = roster_of(system_id=7)
    roster.on_own_heartbeat(beat(7, 0.0, flies=True).message)
    for second in range(4):  # another path to the same one
        roster.on_elsewhere(beat(7, float(second), flies=True))
    assert roster_names(roster, SEVEN, 3.0) == {}
    for second in range(4, 7):
        roster.on_elsewhere(beat(7, float(second), mode=0))
    assert roster_names(roster, SEVEN, 7.0) == {"autopilot-id-elsewhere": False}, "it is not sent our commands"


def test_another_program_with_our_component_id_is_named() -> None:
    roster = roster_of()
    for second in (0.0, 20.0, 21.0):
        roster.on_namesake(ns(second))
    assert roster_names(roster, None, 21.0) == {}
    roster.on_namesake(ns(22.0))
    (conflict,) = roster.conflicts(None, OURS, ns(22.0))
    assert "system 1, component 191" in conflict.what
    assert "vehicle.component_id" in conflict.fix
    assert not conflict.blocks


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
