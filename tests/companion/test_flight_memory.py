"""A service that comes back in the air reads what the one before it knew of the flight."""

import logging
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from companion.base.mission import CONTACT_INTENDED, FLOWN, State
from companion.guidance.flight_memory import FlightMemory
from companion.guidance.pilot import Pilot
from companion.service.flight_keeper import FlightKeeper, keeper_of
from companion.settings.guidance import GuidanceOptions
from drivers.vehicle import VehicleOptions
from estimator.contracts.commands import Hover, Velocity
from tests.companion.test_safety import Loop
from tests.make import ns
from tests.support.waiting import until

service = partial(Loop, "ekf", GuidanceOptions(controller="pid"))
"""Makes a service with the usual estimator and mission."""


def back(before: FlightMemory | None, *, automatic: bool = True, flying: bool = True, hold: bool = False) -> Loop:
    """Return a new service, 2 s after that record, in its first cycle without sight; an order to hold may come before."""
    loop = service(automatic=automatic, flying=flying)
    loop.pilot.landing.before, loop.now = before, ns(102.0)
    if hold:
        loop.pilot.hold()
    loop.tick("no frames")
    return loop


@pytest.mark.parametrize(
    ("state", "begun", "automatic", "then"),
    [
        (State.COMMIT, True, False, State.SEARCH), (State.COMMIT, True, True, State.SEARCH),
        (State.PAUSED, True, True, State.PAUSED),
        (State.PAUSED, False, True, State.PAUSED), (State.ABORTED, True, True, State.ABORTED),
        (State.READY, False, False, State.READY),
        (State.LANDED, True, True, State.SEARCH), (State.REFUSED, True, False, State.READY),
    ],
)  # fmt: skip
def test_a_landing_goes_on_and_a_person_s_hold_stays_one(state: State, begun: bool, automatic: bool, then: State) -> None:
    loop = back(FlightMemory(ns(100.0), state.name, begun, 0.3), automatic=automatic)
    assert loop.pilot.state is then
    held = back(FlightMemory(ns(100.0), state.name, begun, 0.3), automatic=automatic, hold=True).pilot.state
    assert held is State.PAUSED if state is State.COMMIT else held not in FLOWN
    assert loop.pilot.landing.mission.begun is (then is State.SEARCH or (begun and then is not State.READY))


def test_a_service_that_comes_back_stays_over_the_pad_where_that_was_the_order() -> None:
    for state in (State.STAY, State.HOLD_BLIND, State.SEARCH):
        assert back(FlightMemory(ns(100.0), state.name, True, 3.0, stays=True)).pilot.landing.mission.stays
    assert not back(FlightMemory(ns(100.0), "STAY", True, 3.0)).pilot.landing.mission.stays


@pytest.mark.parametrize(
    ("memory", "more"),
    [
        (FlightMemory(ns(71.9), "PAUSED", True), {}), (FlightMemory(ns(103.0), "PAUSED", True), {}),
        (FlightMemory(ns(100.0), "NO_SUCH_STATE", True), {}), (None, {}),
    ],
)  # fmt: skip
def test_what_is_old_from_the_future_or_strange_is_not_used(memory: FlightMemory | None, more: dict[str, Any]) -> None:
    assert back(memory, **more).pilot.state is State.SEARCH


@pytest.mark.hazard("H6")
@pytest.mark.parametrize("state", [State.COMMIT, State.SEARCH, State.PAUSED, State.REFUSED, State.READY, State.TAKEN])
@pytest.mark.parametrize("automatic", [False, True])
def test_a_vehicle_that_changed_its_mode_meanwhile_is_a_person_s_until_he_orders_to_begin(state: State, automatic: bool) -> None:
    left = () if state is State.TAKEN else ("guided", "auto.loiter")
    loop = back(FlightMemory(ns(100.0), state.name, True, 0.3, left), automatic=automatic)
    loop.pilot.landing._resumes = automatic  # its velocity mode would be an order
    assert {loop.tick().command for _ in range(20)} == {Hover()}
    assert loop.pilot.state is (State.TAKEN if automatic else State.READY)
    loop.pilot.begin()
    assert isinstance(loop.tick("no frames").command, Velocity)
    same = FlightMemory(ns(100.0), "COMMIT", True, 0.3, ("guided", "hovering"))
    assert back(same, automatic=False).pilot.state is State.SEARCH


def test_a_vehicle_that_stood_meanwhile_begins_another_flight() -> None:
    loop = back(FlightMemory(ns(100.0), "PAUSED", True), flying=False)
    loop.flying = True
    loop.tick("no frames")
    assert loop.pilot.state is State.SEARCH


@pytest.mark.parametrize("state", [state for state in State if state in FLOWN])
def test_a_vehicle_that_was_let_down_to_the_deck_and_stands_has_landed(state: State) -> None:
    loop = back(FlightMemory(ns(100.0), state.name, True, 0.1))
    loop.flying = False
    loop.tick("no frames")
    assert loop.pilot.state is (State.LANDED if state in CONTACT_INTENDED else State.LANDED_BY_OTHERS)


def test_a_height_that_was_known_spares_a_climb_as_far_as_a_deck_cannot_have_taken_it() -> None:
    for height_m, known_m in ((6.0, 5.0), (0.3, 0.0), (None, None)):
        found = back(FlightMemory(ns(100.0), "SEARCH", True, height_m)).pilot.landing.memory
        assert found.height_m == (None if known_m is None else pytest.approx(known_m, abs=0.1))


class Vehicle(VehicleOptions, frozen=True):
    called: str

    @property
    def name(self) -> str:
        return self.called

    def modes_left(self, mode: str) -> tuple[str, ...]:
        return (mode, "brake")


async def test_the_file_is_replaced_each_half_second_and_at_changes_and_read_by_the_next_service(tmp_path: Path) -> None:
    path, first, first_one = tmp_path / "flight", service(), Vehicle("the first one")
    keeper = FlightKeeper(path, first.pilot, first_one, "boot")
    texts = set()
    for _ in range(100):
        first.tick()
        keeper.on_decision(first.pilot.decide(first.now))
        await until(lambda: not keeper._writer.busy)
        texts.add(path.read_bytes())
    assert 2 <= len(texts) < 20
    for vehicle, boot, used in ((first_one, "boot", True), (Vehicle("another"), "boot", False), (first_one, "b", False)):
        second: Pilot = service().pilot
        FlightKeeper(path, second, vehicle, boot)
        assert (second.landing.before is not None) is used
        assert second.landing.before is None or second.landing.before.modes == ("hovering", "brake")


@pytest.mark.parametrize(
    "text",
    [
        b"", b"{", b"[1]", b'{"boot": 1}', b"\xff" * 9000, b'{"boot": "b", "vehicle": "v", "memory": {}}',
    ],
)  # fmt: skip
def test_a_file_with_a_fault_is_named_and_not_used(text: bytes, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "flight").write_bytes(text)
    pilot = service().pilot
    with caplog.at_level(logging.ERROR):
        FlightKeeper(tmp_path / "flight", pilot, Vehicle("v"), "b")
    assert pilot.landing.before is None
    assert str(tmp_path / "flight") in caplog.text


async def test_a_folder_that_cannot_be_written_is_named_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    loop = service()
    keeper = keeper_of(loop.pilot, Vehicle("v"), {"STATE_DIRECTORY": str(tmp_path / "absent")})
    for _ in range(60):
        loop.tick()
        keeper.on_decision(loop.pilot.decide(loop.now))
        await until(lambda: not keeper._writer.busy)
    assert caplog.text.count("cannot be written") == 1
    assert keeper_of(loop.pilot, Vehicle("v"), {}) is None
