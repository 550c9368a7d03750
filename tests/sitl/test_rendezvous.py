"""Flights from 60 m away to a ship that reports her place, through navdata, and what her wrong reports lead to."""

import pytest

from tests.fly import simulate


def test_from_60_m_away_it_finds_the_ship_and_lands(capsys: pytest.CaptureFixture[str]) -> None:
    code, ending = simulate(capsys, "rendezvous")
    assert (code, ending["outcome"], ending["landed_on_pad"]) == (0, "landed", True)
    assert ending["contacts_outside_commit"] == 0
    assert ending["duration_s"] < 90.0


def test_a_deck_under_the_drone_before_it_sees_the_pad_is_no_leap_of_its_velocity(capsys: pytest.CaptureFixture[str]) -> None:
    """The flow measures against the deck, which goes on at 1.5 m/s, for a second before the first sighting."""
    code, ending = simulate(capsys, "rendezvous", "--seed", "3014", level="model")
    assert (code, ending["outcome"], ending["landed_on_pad"]) == (0, "landed", True)


@pytest.mark.parametrize(
    ("scenario", "words"),
    [
        ("faults/ship_place_stops", "the ship's newest place is"),
        ("faults/ship_place_jumps", "reported place jumped"),
        ("faults/ship_place_late", "come too late"),
    ],
)
def test_wrong_places_are_refused_with_their_reason(capsys: pytest.CaptureFixture[str], scenario: str, words: str) -> None:
    code, ending = simulate(capsys, scenario)
    assert (code, ending["outcome"], ending["contacts"]) == (0, "refused", [])
    assert words in str(ending["refused"])


def test_a_drone_without_a_receiver_refuses_and_gives_the_reason(capsys: pytest.CaptureFixture[str]) -> None:
    code, ending = simulate(capsys, "rendezvous", "--set", "vehicle.gnss_hz=0")
    assert (code, ending["outcome"]) == (1, "refused")
    assert "the drone does not know its own place (no GNSS)" in str(ending["refused"])
