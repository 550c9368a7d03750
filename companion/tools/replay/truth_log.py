"""Keep recorded truth in the log of a report."""

from __future__ import annotations

import math

import numpy as np

from companion.recording.records import ContactRecord, TruthRecord
from companion.tools.report.figures import body_over_pad
from companion.tools.report.flight_log import FlightLog, LoggedContact, TruthSample
from estimator.contracts.geometry import Rotation
from estimator.contracts.time import MonoNs


def add_truth(log: FlightLog, truth: TruthRecord) -> None:
    """Append the truth of one instant, and its newest contact if that is another one than before."""
    d, v = np.array(truth.d_body_pad_level), np.array(truth.v_pad_level)
    p = None if truth.p_pad_ned is None else np.array(truth.p_pad_ned)
    R = None if truth.R_ned_pad is None else Rotation(np.array(truth.R_ned_pad).reshape(3, 3))
    log.truth.append(TruthSample(MonoNs(truth.at_ns), d, v, truth.yaw_rad, p, R))
    if truth.touchdown is not None and all(contact.at != truth.touchdown.at_ns for contact in log.contacts):
        log.contacts.append(_contact(truth.touchdown, truth))


def _contact(of: ContactRecord, truth: TruthRecord) -> LoggedContact:
    """Return a contact; its place is that of the first truth which names it."""
    lateral_m, yaw_rad, down_m_s, aside_m_s = (
        math.nan if x is None else x for x in (of.lateral_m, of.yaw_rad, of.vertical_speed_m_s, of.lateral_speed_m_s)
    )
    along, starboard, _ = body_over_pad(np.array([truth.d_body_pad_level]), np.array([truth.yaw_rad]))[0].tolist()
    where = (along, starboard)
    return LoggedContact(MonoNs(of.at_ns), lateral_m, down_m_s, aside_m_s, of.on_pad, of.surface, where, yaw_rad)
