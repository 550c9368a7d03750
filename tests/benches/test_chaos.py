"""The chaos bench draws the same flight for a seed, judges only what is the service's, and writes what it can fly again."""

import pytest

from benches.chaos import KINDS, WORDS, Chaos, Event, Seen, as_toml, draw, judged, message_ids, of_toml
from drivers.mavlink.dialect import mav


def chaos_flight(lines: tuple[tuple[float, str], ...] = (), hole: tuple[float, float] = (0.0, 0.0)) -> Seen:
    """Return a flight with a command each 0.04 s from instant 100 s on, for 20 s, apart from a hole, and heartbeats likewise."""
    commands = [100.0 + 0.04 * n for n in range(500)]
    beats = [100.0 + n for n in range(20)]
    out = Seen(lines=list(lines), began=100.0, code=0)
    out.commands, out.beats = ([t for t in ts if not hole[0] < t < hole[1]] for ts in (commands, beats))
    return out


def test_a_seed_is_a_flight_and_all_kinds_are_drawn() -> None:
    drawn = [draw(seed, None) for seed in range(200)]
    assert drawn == [draw(seed, None) for seed in range(200)]
    assert {event.kind for chaos in drawn for event in chaos.events} == set(KINDS) >= set(WORDS)
    assert {chaos.vehicle for chaos in drawn} == {"mavlink", "ardrone"}
    assert all(1 <= len(chaos.events) <= 3 for chaos in drawn)


def test_what_is_written_is_flown_again() -> None:
    flights = [draw(seed, None) for seed in range(10)]
    assert of_toml(as_toml([judged(chaos, chaos_flight()) for chaos in flights])) == flights


@pytest.mark.parametrize(("kind", "good"), [("cpu_hogs", False), ("link_stalls", True), ("service_stopped", True)])
def test_a_gap_counts_unless_it_is_the_links_own(kind: str, good: bool) -> None:
    chaos = Chaos(1, "mavlink", (Event(kind, 5.0, 4.0),))
    row = judged(chaos, chaos_flight(((106.0, "no status; it stood still"),), hole=(105.0, 109.0)))
    assert row.good == good
    assert (row.gap_s > 3.9) == (not good)
    assert (row.beats_missed > 0) == (not good)


def test_an_event_without_a_word_in_time_is_reported() -> None:
    chaos = Chaos(1, "mavlink", (Event("disk_full", 2.0, 1.0),))
    assert judged(chaos, chaos_flight(((104.0, "recorder: No space left on device"),))).good
    late = judged(chaos, chaos_flight(((114.0, "recorder: No space left on device"),)))
    assert late.unnamed == ("disk_full",)
    assert not late.good
    asleep = Chaos(1, "mavlink", (Event("disk_full", 2.0, 1.0), Event("service_stopped", 1.0, 3.0)))
    assert judged(asleep, chaos_flight(((104.0, "the service stood still"),))).good, "a stopped service meets no full disk"


def test_messages_are_distinguished_in_a_datagram() -> None:
    packer = mav.MAVLink(None, 1, 191)
    data = b"".join(
        m.pack(packer) for m in (mav.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), mav.MAVLink_system_time_message(1, 2))
    )
    assert list(message_ids(data)) == [0, 2]
