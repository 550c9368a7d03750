"""Relative positions of u-blox receivers: what pyubx2 encodes, what damage does to it, and how it arrives."""

import asyncio
import math
import os
import socket
import tty
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.parts.ship.options import RtkOptions
from companion.parts.ship.part import RtkPart
from drivers.clock import SystemClock
from drivers.mailbox import Line
from drivers.relpos import RelposOptions, RelposReader
from estimator.contracts.samples import Baseline, Sample, VesselReport
from estimator.contracts.time import MonoNs
from tests.support.waiting import answering, free_port, until

pyubx2 = pytest.importorskip("pyubx2", reason="the extra ship is not installed")

START = MonoNs(50_000_000_000)
GOOD = {
    "gnssFixOK": 1, "diffSoln": 1, "relPosValid": 1, "carrSoln": 2, "isMoving": 1, "relPosHeadingValid": 1,
    "accN": 7.0, "accE": 9.0, "accD": 12.0, "accHeading": 0.3, "relPosHeading": 93.5,
}  # fmt: skip


def message(t_s: float = 0.0, version: int = 1, **changed: Any) -> bytes:
    """Return a message with a baseline of 1.2346, -2.5, -3.1001 m, as the library encodes it."""
    fields = {"relPosN": 123, "_HPrelPosN": 0.46, "relPosE": -250, "relPosD": -310, "_HPrelPosD": -0.01, **GOOD, **changed}
    if version == 0:
        fields = {name: value for name, value in fields.items() if "Heading" not in name}
    made = pyubx2.UBXMessage("NAV", "NAV-RELPOSNED", pyubx2.GET, version=version, iTOW=round(1e3 * t_s), **fields)
    return bytes(made.serialize())


def at(t_s: float) -> MonoNs:
    return MonoNs(START + round(1e9 * t_s))


def reader(**options: Any) -> RelposReader:
    return RelposReader(RelposOptions(**options))


@pytest.mark.parametrize("version", [0, 1])
def test_a_fixed_solution_is_a_baseline_with_its_high_precision_parts_and_an_honest_sigma(version):
    (found,) = reader(delay_s=0.2).take(message(version=version), at(0.0))
    assert found.fix == "fixed"
    assert found.d_ned == pytest.approx([1.2346, -2.5, -3.1001], abs=1e-9)
    assert np.sqrt(np.diag(found.cov_ned)) == pytest.approx([0.01221, 0.01345, 0.02332], abs=1e-4)
    assert found.stamp.delay_s == pytest.approx(0.2)


def test_a_float_claims_decimetres_whatever_the_receiver_does_and_extrapolation_costs():
    (floating,) = reader().take(message(carrSoln=1, accN=0.1, accE=0.1, accD=0.1), at(0.0))
    (carried,) = reader().take(message(refObsMiss=1), at(0.0))
    (fixed,) = reader().take(message(), at(0.0))
    assert floating.fix == "float"
    assert np.diag(floating.cov_ned).min() >= 0.3**2
    assert np.diag(carried.cov_ned).min() > 5.0 * np.diag(fixed.cov_ned).min()


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"gnssFixOK": 0}, "no_fix"),
        ({"diffSoln": 0}, "base_silent"),
        ({"relPosValid": 0}, "base_silent"),
        ({"refPosMiss": 1}, "base_silent"),
        ({"isMoving": 0}, "base_not_moving"),
        ({"carrSoln": 0}, "no_carrier_solution"),
        ({"carrSoln": 3}, "no_carrier_solution"),
        ({"relPosE": 40_000}, "too_long"),
        ({"relPosNormalized": 1}, "too_long"),
        ({"accD": 4e5}, "inaccurate"),
    ],
)
def test_what_is_no_baseline_is_refused_with_its_reason(changed, why):
    read = reader()
    assert read.take(message(**changed), at(0.0)) == []
    assert read.refused == {why: 1}


def test_it_is_stamped_by_the_receiver_s_clock_over_the_end_of_a_week_and_refused_where_it_is_late():
    read, late_s = reader(delay_s=0.1), (0.05, 0.0, 0.21, 0.02, 0.9)
    week_s = 604_800.0
    found: list[Sample] = []
    for n, late in enumerate(late_s):
        t_s = 0.1 * n
        found += read.take(message((week_s - 0.25 + t_s) % week_s), at(t_s + 0.1 + late))
    took = [(s.stamp.measured_at - START) * 1e-9 for s in found]
    assert took == pytest.approx([0.05, 0.1, 0.2, 0.3], abs=0.011)
    assert read.refused == {"too_old": 1}


def test_a_change_of_the_solution_is_counted_and_logged_with_its_step(caplog):
    caplog.set_level("INFO")
    read = reader()
    for n, carrier in enumerate((1, 1, 2, 1)):
        read.take(message(0.1 * n, carrSoln=carrier, relPosN=123 + 40 * (carrier == 2)), at(0.1 * n))
    assert read.taken == {"float": 3, "fixed": 1, "became_fixed": 1, "became_float": 1}
    assert "the baseline is fixed, it was float: it moved by 0.40 m in 0.1 s" in caplog.messages


def test_two_antennas_on_the_ship_give_her_bow_and_only_while_that_is_fixed():
    read = reader(mount_rad=math.radians(90.0))
    (found,) = read.take(message(), at(0.0))
    assert isinstance(found, VesselReport)
    assert found.heading_rad == pytest.approx(math.radians(3.5))
    assert found.sigma_heading_rad == pytest.approx(math.radians(math.hypot(0.3, 0.2)), rel=1e-3)
    assert read.take(message(0.1, carrSoln=1) + message(0.2, relPosHeadingValid=0) + message(0.3, version=0), at(0.3)) == []
    assert read.refused == {"no_heading": 3}


def test_a_base_on_the_drone_turns_the_vector_round():
    (found,) = reader(reverse=True).take(message(), at(0.0))
    assert found.d_ned == pytest.approx([-1.2346, 2.5, 3.1001])


@given(st.binary(max_size=60), st.integers(0, 71), st.integers(1, 255), st.lists(st.integers(1, 40), max_size=8))
def test_whatever_lies_between_and_wherever_it_is_cut_whole_messages_are_read(noise, damaged, flip, cuts):
    bad = bytearray(message())
    bad[damaged] ^= flip
    read, found = reader(), list[Sample]()
    stream = (
        noise + message() + b"$GNGGA,,*00\r\n" + bytes(bad) + b"\xd3\x00\x13" + noise + message(0.1) + message(0.2) + message(0.3)
    )
    begin = 0
    for size in [*cuts, len(stream)]:
        found += read.take(stream[begin : begin + size], at(0.4))
        begin += size
    assert len(found) >= 3, "one at most is lost to a damaged length before it"
    assert all(isinstance(one, Baseline) and np.linalg.norm(one.d_ned) < 5.0 for one in found)


def test_another_sender_is_refused_until_the_first_is_silent():
    read, first, second = reader(), ("10.0.0.1", 1), ("10.0.0.2", 1)
    assert read.take(message()[:30], at(0.0), first) == []
    assert read.take(message(0.1), at(0.1), second) == []
    assert len(read.take(message()[30:], at(0.2), first)) == 1
    assert len(read.take(message(11.0), at(11.0), second)) == 1
    assert read.refused == {"wrong_sender": 1}


@pytest.mark.parametrize(
    ("changed", "match"),
    [
        ({"source": "here"}, "source must be ADDRESS:PORT"),
        ({"source": "udpout://10.0.0.1:5"}, "source must be"),
        ({"heading": "ship:99"}, "heading must be"),
        ({"antenna_m": "1, 2"}, "antenna_m must be three numbers"),
        ({"ship_antenna_m": "1, 2, nan"}, "ship_antenna_m: each number must lie in"),
        ({"delay_s": 2.0}, "delay_s must lie in"),
    ],
)
def test_settings_that_cannot_be_are_refused_by_their_key(changed, match):
    with pytest.raises(ValueError, match=match):
        RtkOptions(**changed)


async def test_it_arrives_by_udp_tcp_and_a_serial_port():
    """Each on loopback, the serial port as a pseudo-terminal; garbage before it is counted and named once."""
    port = free_port()
    master, slave = os.openpty()
    tty.setraw(slave)

    async def feed(ended: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(message())
        await ended.read()
        writer.close()

    async with answering(feed) as tcp:
        for source in (f"127.0.0.1:{port}", f"tcp://127.0.0.1:{tcp}", f"serial://{os.ttyname(slave)}:115200"):
            reports = Line[Sample](16)
            part = RtkPart(RtkOptions(source=source), "source", reports, SystemClock())
            running = asyncio.create_task(part.run())
            async with asyncio.timeout(10):
                if source.startswith("serial"):
                    await asyncio.sleep(0.1)
                    os.write(master, message(isMoving=0) + message())
                elif not source.startswith("tcp"):
                    await asyncio.sleep(0.1)
                    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
                        own.sendto(message(), ("127.0.0.1", port))
                await until(lambda part=part: part.counted().get("taken_fixed") == 1.0)
            assert [type(one) for one in reports.waiting()] == [Baseline]
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
        assert part.counted()["refused_base_not_moving"] == 1.0
    os.close(master)
    os.close(slave)
