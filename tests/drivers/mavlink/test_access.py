"""Ids count only with the link and the peer that they come from."""

import logging

import pytest

from drivers.mavlink.access import Access, AccessLevel, Named, NamedSenders, Source, parse_operators
from estimator.contracts.errors import BadInput
from tests.make import ns

A: Source = (0, ("10.0.0.1", 14550))
B: Source = (0, ("10.0.0.66", 14550))
CABLE: Source = (1, None)
STATION, AUTOPILOT, SHIP = (255, 190), (1, 1), (17, 1)


def level(access: Access, source: Source, ids: tuple[int, int], seconds: float = 0.0, *, signed: bool = False) -> AccessLevel:
    return access.level(source, ids, ns(seconds), asked_for=source[1] is None, signed=signed)


@pytest.mark.parametrize(
    ("access", "source", "ids", "expected"),
    [
        *((Access(NamedSenders()), A, ids, AccessLevel.UNKNOWN) for ids in (STATION, AUTOPILOT, SHIP, (66, 1))),
        (Access(NamedSenders()), CABLE, STATION, AccessLevel.PEER),
        (Access(NamedSenders(), autopilot=(A, AUTOPILOT)), A, STATION, AccessLevel.OPERATOR),
        (Access(NamedSenders(), autopilot=(A, AUTOPILOT)), B, STATION, AccessLevel.UNKNOWN),
        (Access(NamedSenders(reporters=frozenset({17}))), A, SHIP, AccessLevel.REPORTER),
        (Access(NamedSenders(reporters=frozenset({17}))), CABLE, SHIP, AccessLevel.PEER),
    ],
)
def test_by_default_nobody_may_command(access: Access, source: Source, ids: tuple[int, int], expected: AccessLevel) -> None:
    assert level(access, source, ids) is expected


@pytest.mark.parametrize("signed", [False, True])
def test_nobody_else_is_taken_for_the_autopilot(signed: bool) -> None:
    access = Access(NamedSenders((Named(1),)), autopilot=(A, AUTOPILOT))
    for elsewhere in (B, CABLE):
        assert level(access, elsewhere, AUTOPILOT, signed=signed) is AccessLevel.UNKNOWN
    assert access.refused["impostor"] == 2
    assert level(access, A, AUTOPILOT, signed=signed) is AccessLevel.OPERATOR


def test_a_named_system_is_held_to_its_peer_until_that_one_falls_silent() -> None:
    access = Access(NamedSenders((Named(255),), silence_s=30.0))
    assert level(access, A, STATION, 0.0) is AccessLevel.OPERATOR
    assert level(access, B, STATION, 1.0) is AccessLevel.UNKNOWN
    assert level(access, B, (255, 1), 2.0) is AccessLevel.UNKNOWN, "another component is no way in"
    assert level(access, A, STATION, 29.0) is AccessLevel.OPERATOR
    assert level(access, B, STATION, 58.0) is AccessLevel.UNKNOWN
    assert level(access, B, STATION, 60.0) is AccessLevel.OPERATOR
    assert access.refused["impostor"] == 3


def test_an_unknown_peer_that_stays_is_reported_once_with_the_cure(caplog: pytest.LogCaptureFixture) -> None:
    access = Access(NamedSenders())
    with caplog.at_level(logging.WARNING):
        for n in range(100):
            access.refuse_unknown(STATION, A[1], ns(0.1 * n))
        for system in range(1, 250):
            for n in range(2):
                access.refuse_unknown((system, 200), B[1], ns(20.0 + 5.0 * n))
    assert [r.getMessage() for r in caplog.records if "system 255" in r.getMessage() and "`operators`" in r.getMessage()]
    assert len(caplog.records) <= 64, "a flood of ids neither fills the log nor the memory"
    assert len(access._unknown_senders) <= 64
    assert access.refused["unknown"] == 100 + 498


def test_operators_as_people_write_them() -> None:
    assert parse_operators("") == ()
    assert parse_operators("255, 245/190") == (Named(255), Named(245, 190))
    assert [str(n) for n in parse_operators("255,1/2")] == ["255", "1/2"]
    for wrong in ("0", "256", "255/", "/1", "a", "255;1", "255,", "1/2/3", "-1"):
        with pytest.raises(BadInput, match="operator"):
            parse_operators(wrong)
