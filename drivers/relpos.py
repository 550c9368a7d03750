"""NAV-RELPOSNED of u-blox receivers to samples: the baseline of a moving base, and a ship's heading by two antennas.

pyubx2 takes the messages apart; here is what they are worth. A receiver states the noise of its solution; reflections at the
antennas wander beside that, alike for minutes, and a wrong whole number of wavelengths is in no sigma at all: whoever fuses
these samples has to compare them with other witnesses. Nothing on the wire raises; what is not taken is counted by its reason.

Source: u-blox, F9 HPG 1.32 interface description (UBX-22008968), section UBX-NAV-RELPOSNED, and that of the M8 for version 0.
"""

import importlib
import logging
import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from msgspec import Struct

from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.endpoint import Address
from drivers.extras import require
from drivers.ship_reports import FLOOR_M
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.samples import Baseline, BaselineFix, VesselReport
from estimator.contracts.time import NS_PER_S, MonoNs, seconds_between

log = logging.getLogger(__name__)

_BEGIN = b"\xb5\x62\x01\x3c"
"""Sync characters, class and id of the one message that is read; all others of a stream are passed over."""
_FRAME_BYTES = {0: 48, 1: 72}
"""Length of a whole message by its version."""
_WEEK_NS = 604_800 * NS_PER_S  # period of the receiver's time of week
_HELD_S = 10.0
"""Silence after which datagrams of another sender are taken."""
AGE_MAX_S = 0.7
"""Time by which a solution may be later than the earliest ones and is still used."""
_FIXES: dict[int, BaselineFix] = {1: "float", 2: "fixed"}
_EXTRAPOLATED_M = 0.03
"""Standard deviation beside it where observations of the base are missing, and older ones are carried on, m."""
_HEADING_FLOOR_RAD = math.radians(0.2)  # standard deviation of a heading that no receiver states (assumed)
_SIGMA_MAX_M = 30.0  # a solution with a larger standard deviation is refused


class RelposOptions(Struct, frozen=True):
    """The receivers of one stream: delay, reach and mounting."""

    delay_s: float = 0.15
    """Least time from the instant of a solution to its arrival, s; it cannot be measured from this side."""
    length_max_m: float = 300.0
    """Distance beyond which a solution is not of the ship below."""
    reverse: bool = False
    """True if the base is the drone's antenna and the rover the ship's."""
    antenna_body: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The drone's antenna from the body's origin, m in the body's axes."""
    antenna_vessel: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The ship's antenna from the pad's centre, m towards the bow, to starboard, down."""
    alone: bool = False
    """True if the estimate may begin with a baseline."""
    mount_rad: float | None = None
    """Direction from base to rover against the bow, where both are on the ship; None where one is on the drone."""


class RelposReader:
    """Reads the relative positions of one stream: baselines, or headings if both antennas are on the ship.

    Raises:
        BadInput: pyubx2 is not installed.
    """

    def __init__(self, options: RelposOptions) -> None:
        require("[rtk]", "ship", "pyubx2")
        self._parse: Any = importlib.import_module("pyubx2").UBXReader.parse
        self._is_whole: Any = importlib.import_module("pyubx2.ubxhelpers").isvalid_checksum
        self._o = options
        self._clock = ClockMap(
            ClockMapOptions(
                wrap_ns=_WEEK_NS, resolution_s=0.001, floor_s=options.delay_s, floor_sigma_s=0.2 * options.delay_s,
                window_s=60.0, name="the receiver",
            )
        )  # fmt: skip
        self._arms = np.array(options.antenna_body), np.array(options.antenna_vessel)
        self._rest = b""
        self._held: tuple[Address, MonoNs] | None = None
        self._newest: Baseline | None = None
        self.taken: Counter[str] = Counter()
        """Numbers of samples by the kind of their solution, and of its changes."""
        self.refused: Counter[str] = Counter()
        """Number of messages that were not taken, by reason."""

    def take(self, data: bytes, received_at: MonoNs, sender: Address | None = None) -> list[Baseline | VesselReport]:
        """Return the samples of the messages that are complete with these bytes.

        Args:
            sender: of a datagram; the first one is read until it is silent. None where there is only one.
        """
        if sender is not None:
            if self._held is not None and sender != self._held[0] and seconds_between(self._held[1], received_at) < _HELD_S:
                self.refused["wrong_sender"] += 1
                return []
            if self._held is None or sender != self._held[0]:
                self._rest = b""
            self._held = sender, received_at
        made: list[Baseline | VesselReport] = []
        for frame in self._frames(data):
            try:
                why = self._message(frame, received_at, made)
            except Exception:  # the library raises many kinds on damaged fields, and none of it may end the part
                why = "malformed"
            if why:
                self.refused[why] += 1
        return made

    def _frames(self, data: bytes) -> Iterator[bytes]:
        held, at = self._rest + data, 0
        while (at := held.find(_BEGIN, at)) >= 0 and len(held) > at + 6:
            size = _FRAME_BYTES.get(held[at + 6], 0)
            if size != 8 + int.from_bytes(held[at + 4 : at + 6], "little"):
                self.refused["length"] += 1
                at += 2
                continue
            if len(held) < at + size:
                break
            frame = held[at : at + size]
            if self._is_whole(frame):
                yield frame
                at += size
            else:
                self.refused["checksum"] += 1
                at += 2
        # The begin of a message may be cut anywhere.
        self._rest = held[at:] if at >= 0 else held[-(len(_BEGIN) - 1) :]

    def _message(self, frame: bytes, received_at: MonoNs, made: list[Baseline | VesselReport]) -> str:
        """Add the samples of a message; return why there are none, empty if there are."""
        m: Any = self._parse(frame)
        stamp = self._clock.stamp(m.iTOW * 1_000_000, received_at)
        if why := _without_solution(m):
            return why
        fix = _FIXES[m.carrSoln]
        if stamp.delay_s - self._o.delay_s > AGE_MAX_S:
            return "too_old"
        d = 0.01 * np.array([m.relPosN, m.relPosE, m.relPosD])
        if m.relPosNormalized or np.linalg.norm(d) > self._o.length_max_m:
            return "too_long"
        if self._o.mount_rad is not None:
            if not hasattr(m, "relPosHeading") or not m.relPosHeadingValid or fix != "fixed":
                return "no_heading"
            heading_rad = wrap_pi(math.radians(m.relPosHeading) - self._o.mount_rad)
            sigma_rad = math.hypot(math.radians(m.accHeading), _HEADING_FLOOR_RAD)
            made.append(VesselReport(stamp, None, None, heading_rad, sigma_rad))
            self.taken["heading"] += 1
            return ""
        sigma = np.hypot(1e-3 * np.array([m.accN, m.accE, m.accD]), FLOOR_M[fix])
        if m.refObsMiss:
            sigma = np.hypot(sigma, _EXTRAPOLATED_M)
        if sigma.max() > _SIGMA_MAX_M:
            return "inaccurate"
        o = self._o
        found = Baseline(stamp, fix, -d if o.reverse else d, np.diag(sigma**2), *self._arms, o.alone)
        self._name_change(found)
        self.taken[fix] += 1
        made.append(found)
        return ""

    def _name_change(self, found: Baseline) -> None:
        before, self._newest = self._newest, found
        if before is None or before.fix == found.fix:
            return
        self.taken[f"became_{found.fix}"] += 1
        log.info(
            "the baseline is %s, it was %s: it moved by %.2f m in %.1f s",
            found.fix, before.fix, np.linalg.norm(found.d_ned - before.d_ned),
            seconds_between(before.stamp.measured_at, found.stamp.measured_at),
        )  # fmt: skip


def _without_solution(m: Any) -> str:
    """Return why a message holds no solution for a moving base, empty if it does."""
    if not m.gnssFixOK:
        return "no_fix"
    if not (m.diffSoln and m.relPosValid) or m.refPosMiss:
        return "base_silent"
    if not m.isMoving:
        return "base_not_moving"
    return "" if m.carrSoln in _FIXES else "no_carrier_solution"
