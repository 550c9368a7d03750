"""Decode the ship's reports of her place from the broker, and check each. No sockets and no clocks.

A report carries the run of the service and its own instant on the drone's clock, as a command does: a copy of an earlier one is
refused after a restart, and one that is late says so itself.
"""

import hmac
import logging
import math
from collections import Counter
from dataclasses import dataclass, field

import msgspec
import numpy as np

from companion.parts.mqtt.messages import ShipReport
from companion.parts.mqtt.signature import Forged, Unsigned, verified
from companion.parts.mqtt.topics import Topics
from drivers.nmea.sentences import COV_SPEED, HEADING_SIGMA_RAD
from estimator.contracts.geodesy import GeoPoint
from estimator.contracts.samples import GeoFix, VesselReport
from estimator.contracts.time import MonoNs, Stamp

log = logging.getLogger(__name__)

REPORT_MAX_BYTES = 1024
_STAMP_SIGMA_S = 0.2
"""Standard deviation of the report's instant: its sender knows the drone's clock by messages that took their time to it."""

_decoder = msgspec.json.Decoder(ShipReport)

Samples = list[GeoFix | VesselReport]


@dataclass(slots=True)
class ShipReportReader:
    """Reads the reports of one ship.

    Args:
        run: the id of this run of the service that only those who may command can read.
        key: the key that reports are signed with; None if the broker decides who may send them.
    """

    topics: Topics
    run: str
    key: bytes | None = field(default=None, repr=False)
    counts: Counter[str] = field(default_factory=Counter)
    """The number of reports by `taken`, or by the reason why they were refused."""
    _newest_ns: int = -1

    def samples(self, payload: bytes, received_at: MonoNs, *, retained: bool = False) -> Samples:
        """Return the samples in one message; none if it is refused, which is counted and logged once for each reason."""
        try:
            out = self._samples(payload, received_at, retained)
        except _Refused as why:
            reason = str(why)
            if reason not in self.counts:
                log.warning("a report of the ship was refused (%s); the next ones are counted only", reason.replace("_", " "))
            self.counts[reason] += 1
            return []
        self.counts["taken"] += 1
        return out

    def _samples(self, payload: bytes, received_at: MonoNs, retained: bool) -> Samples:
        if len(payload) > REPORT_MAX_BYTES:
            raise _Refused("too_long")
        if self.key is not None:
            try:
                payload = verified(self.key, self.topics.vessel, payload)
            except Unsigned:
                raise _Refused("unsigned") from None
            except Forged:
                raise _Refused("bad_signature") from None
        try:
            report = _decoder.decode(payload)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            raise _Refused("malformed") from None
        if retained:
            raise _Refused("retained")
        if not hmac.compare_digest(report.run.encode(errors="replace"), self.run.encode()):
            raise _Refused("other_run")
        if report.at_ns > received_at:
            raise _Refused("ahead")
        if report.at_ns <= self._newest_ns:
            raise _Refused("not_newer")
        self._newest_ns = report.at_ns
        return _samples(report, Stamp(MonoNs(report.at_ns), received_at, _STAMP_SIGMA_S, "synced"))


class _Refused(Exception):
    """A report is not taken; the text is the name of the counter."""


def _samples(report: ShipReport, stamp: Stamp) -> Samples:
    v = None
    if report.speed_m_s is not None and report.course_deg is not None:
        course = math.radians(report.course_deg)
        v = np.array([report.speed_m_s * math.cos(course), report.speed_m_s * math.sin(course), 0.0])
    place = GeoPoint.of_degrees(report.latitude_deg, report.longitude_deg, report.height_m)
    out: Samples = [GeoFix(stamp, "vessel", place, report.sigma_m, v)]
    if v is None and report.heading_deg is None:
        return out
    cov = None if v is None else COV_SPEED
    heading = None if report.heading_deg is None else math.radians(report.heading_deg)
    return [*out, VesselReport(stamp, v, cov, heading, None if heading is None else HEADING_SIGMA_RAD)]
