"""Choice of the autopilot: each ambiguous case is reported with the setting that resolves it, and blocks or does not."""

from dataclasses import replace

import pytest

from drivers.mavlink.dialect import mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.roster import FIRST_S, MOVED_S, Bound, Roster
from estimator.contracts.time import NS_PER_S, MonoNs

OURS = (1, 191)
SEVEN = Bound(7, silent_s=0.1, lost=False, commanded=False, several=False)


def at(seconds: float) -> MonoNs:
    return MonoNs(round((100.0 + seconds) * NS_PER_S))


def beat(
    system: int, seconds: float, *, flies: bool = False, component: int = 1, kind: int = 2, mode: int = 5
) -> ReceivedMessage:
    message = mav.MAVLink_heartbeat_message(kind, 3, 129 if flies else 1, mode, 4 if flies else 3, 3)
    return ReceivedMessage(message, 0, at(seconds), system, component, ("10.0.0.2", 14550 + system))


def roster_of(system_id: int = 0, vessel_id: int = 0) -> Roster:
    return Roster(AutopilotOptions("udpin://127.0.0.1:14550", system_id=system_id, vessel_id=vessel_id))


def receive(roster: Roster, until_s: float, *flying: int, since_s: float = 0.0, systems: tuple[int, ...] = (1, 7)) -> None:
    for second in range(round(since_s), round(until_s) + 1):
        for system in systems:
            roster.on_heartbeat(beat(system, float(second), flies=system in flying))


def roster_names(roster: Roster, bound: Bound | None, seconds: float) -> dict[str, bool]:
    return {one.name: one.blocks for one in roster.conflicts(bound, OURS, at(seconds))}


@pytest.mark.hazard("H8")
@pytest.mark.parametrize("flying", [(), (1, 7)])
def test_of_two_that_fly_or_stand_nobody_is_commanded(flying: tuple[int, ...]) -> None:
    roster = roster_of()
    receive(roster, 3.0, *flying)
    (conflict,) = roster.conflicts(SEVEN, OURS, at(3.0))
    assert conflict.blocks
    assert "system 1 " in conflict.what
    assert "system 7 " in conflict.what
    assert "vehicle.system_id (1 or 7)" in conflict.fix
    assert not roster.chosen(1, SEVEN, at(3.0))
    assert roster_names(roster, SEVEN, 9.0) == {}, "the others are gone"


def test_the_first_that_flies_is_meant_and_not_the_first_that_is_received() -> None:
    roster = roster_of()
    assert roster.chosen(7, None, at(0.0)), "one that is heard is listened to"
    receive(roster, 2.0, 1)
    assert roster.chosen(1, SEVEN, at(2.0))
    one = replace(SEVEN, system=1)
    assert roster_names(roster, one, 2.0) == {"several-autopilots": False}
    receive(roster, 2.0 + FIRST_S, 1, since_s=3.0)
    receive(roster, 12.0, 1, 7, since_s=8.0)
    assert roster_names(roster, one, 12.0) == {"several-autopilots": False}, "the second to fly changes nothing"
    assert not roster.chosen(7, one, at(12.0))
    receive(roster, 16.0, 7, since_s=13.0)
    assert not roster.chosen(7, one, at(16.0)), "nor that the first has landed"


def test_one_that_follows_our_commands_stays_the_one_that_is_meant() -> None:
    roster = roster_of()
    flown = replace(SEVEN, commanded=True)
    roster.commanded(7)
    receive(roster, 3.0, 1, 7)
    assert roster_names(roster, flown, 3.0) == {"several-autopilots": False}
    receive(roster, 30.0, 1, since_s=4.0, systems=(1,))
    silent = replace(flown, lost=True, silent_s=27.0)
    assert not roster.chosen(1, silent, at(30.0))
    (conflict,) = roster.conflicts(silent, OURS, at(30.0))
    assert "vehicle.system_id (1)" in conflict.fix


def test_another_id_is_taken_when_the_autopilot_has_been_silent() -> None:
    roster = roster_of()
    receive(roster, 20.0, systems=(1,))
    early = replace(SEVEN, lost=True, silent_s=4.0)
    late = replace(early, silent_s=3.0 + MOVED_S + 0.1)
    assert not roster.chosen(1, early, at(20.0))
    assert roster.chosen(1, late, at(20.0))
    assert roster_names(roster, late, 20.0) == {"autopilot-id-changed": True}
    roster.on_heartbeat(beat(3, 20.0))
    assert not roster.chosen(1, late, at(20.0)), "which of the two is its new id?"


@pytest.mark.hazard("H8")
def test_two_of_one_id_are_named_and_nobody_is_commanded() -> None:
    roster = roster_of(system_id=7)
    (conflict,) = roster.conflicts(replace(SEVEN, several=True), OURS, at(0.0))
    assert (conflict.name, conflict.blocks) == ("autopilot-id-twice", True)
    assert "system 7" in conflict.what
    for seconds, uid in ((0.0, 0xAB), (0.0, 0xCD), (1.0, 0xAB)):
        roster.note_uid(uid, at(seconds))
    assert roster_names(roster, SEVEN, 1.0) == {}, "one odd answer is none"
    roster.note_uid(0xCD, at(3.0))
    (conflict,) = roster.conflicts(SEVEN, OURS, at(3.0))
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
        roster.on_namesake(at(second))
    assert roster_names(roster, None, 21.0) == {}
    roster.on_namesake(at(22.0))
    (conflict,) = roster.conflicts(None, OURS, at(22.0))
    assert "system 1, component 191" in conflict.what
    assert "vehicle.component_id" in conflict.fix
    assert not conflict.blocks
