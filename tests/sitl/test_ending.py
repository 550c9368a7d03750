"""The JSON of an ending has the same keys whoever judged the flight."""

from collections import Counter

from companion.base.mission import FlightOutcome
from estimator.contracts.time import MonoNs
from sitl.flight.ending import Contact, Ending, FlightGrade

KEYS = {
    "scenario", "seed", "landed_on_pad", "outcome", "refused", "duration_s", "touchdown", "contacts", "contacts_outside_commit",
    "in_water", "frames", "cpu_s",
}  # fmt: skip
TOUCHDOWN = {"surface", "on_pad", "lateral_m", "yaw_deg", "vertical_speed_m_s", "lateral_speed_m_s"}


def test_every_ending_has_the_keys_that_machines_read() -> None:
    contact = Contact(MonoNs(2_000_000_000), "pad", 0.03, 0.1, 0.4, 0.05, "landing", True, "land")
    bare = Ending("calm", 1, FlightOutcome.LANDED, (contact,), 3.0, Counter())
    grade = FlightGrade("on pad", "3 cm", (), None, 0, None, 0, (), "land", 1.5)
    judged = Ending("calm", 1, FlightOutcome.LANDED, (contact,), 3.0, Counter(), judged=grade)
    for ending in (bare, judged):
        reported = ending.as_json()
        assert set(reported) >= KEYS
        assert set(reported["touchdown"]) >= TOUCHDOWN
        assert set(reported["contacts"][0]) >= TOUCHDOWN | {"at_s", "phase", "motors"}
    assert bare.as_json()["cpu_s"] is None
    assert judged.as_json()["cpu_s"] == 1.5
