"""The chaos bench draws the same flight for a seed, judges only what is the service's, and writes what it can fly again."""

import pytest

from benches.chaos import Chaos, Event, Seen, as_toml, draw, judged, of_toml


def chaos_flight(lines: tuple[tuple[float, str], ...] = (), hole: tuple[float, float] = (0.0, 0.0)) -> Seen:
    """Return a flight with a command each 0.04 s from instant 100 s on, for 20 s, apart from a hole, and heartbeats likewise."""
    commands = [100.0 + 0.04 * n for n in range(500)]
    beats = [100.0 + n for n in range(20)]
    out = Seen(lines=list(lines), began=100.0, code=0)
    out.commands, out.beats = ([t for t in ts if not hole[0] < t < hole[1]] for ts in (commands, beats))
    return out


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
