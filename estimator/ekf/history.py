"""Out-of-sequence measurements: insert a late event at the instant when it was measured and re-propagate the later events.

The result equals the one of events received in order: the history keeps every recent event with the belief after it, and
`process_event` does not depend on when an event was received.
"""

import math
from collections.abc import Sequence
from functools import partial
from itertools import chain, repeat, starmap
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.fusion import FusionResult
from estimator.contracts.geometry import F64, rpy_matrix, wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.core.abi import DL_WITH_COVARIANCE
from estimator.ekf import deck_motion_bank, so3
from estimator.ekf.options import EkfOptions
from estimator.ekf.outcome import Outcome, result
from estimator.ekf.packed_belief import Followed, PackedBelief
from estimator.ekf.packed_event import Event, PackedEvent, packed_event
from estimator.ekf.params import FilterParams
from estimator.ekf.so3 import Vec3
from estimator.ekf.state import (
    ATT_BIAS,
    ATT_ERR,
    PAD_YAW,
    POS_REL,
    VEL,
    VESSEL_VEL,
    WAVES,
    Belief,
    N,
    initial,
)  # fmt: skip
from estimator.late import Late

_FELT_TILT_RAD = math.radians(12.0)
"""Standard deviation of the tilt from the accelerometer alone: a multirotor measures its thrust, which tilts with the body."""


def process_event(b: Belief | None, event: Event, params: FilterParams) -> tuple[Belief | None, Outcome]:
    """Return the belief after one event, which must not be older than the belief, and the event's outcome.

    A refused event leaves the belief unchanged. `b` is None before the first attitude.
    """
    if b is None:
        return _first(event, params)
    packed = PackedBelief.of(b)
    followed = packed.follow(params, [packed_event(event)])
    if followed:
        return followed[0].belief, followed.outcomes(1)[0]
    assert isinstance(event, Attitude)
    return _set_by(packed.propagated(event.stamp.measured_at, params, DL_WITH_COVARIANCE).belief, event, params)


def _first(event: Event, params: FilterParams) -> tuple[Belief | None, Outcome]:
    """Initialize the belief from an attitude, or from the tilt that an accelerometer at about 1 g shows."""
    o = params.options
    t = event.stamp.measured_at
    if isinstance(event, Attitude):
        b = initial(
            o, t, event.R_ned_body.matrix, o.sigma_initial_tilt_rad, o.sigma_initial_heading_rad, deck_motion_bank.unknown()
        )
        return _levelled(_correlated(b, o), event), Outcome(Verdict.FUSED)
    if isinstance(event, Imu):
        f = event.f_body
        size = float(np.linalg.norm(f))
        if abs(size - G_M_S2) < 0.5 * G_M_S2:
            x, y, z = f.tolist()
            R = rpy_matrix(math.atan2(-y, -z), math.atan2(x, math.hypot(y, z)), 0.0)
            b = initial(o, t, R, _FELT_TILT_RAD, math.radians(2.0), deck_motion_bank.unknown())
            w = _floats(event.w_body)
            return b._replace(t_imu=t, w=w, w_smooth=w, f=(x, y, z)), Outcome(Verdict.FUSED)
    return None, Outcome(Verdict.NO_ATTITUDE)


def _correlated(b: Belief, o: EkfOptions) -> Belief:
    """Correlate the attitude error with the attitude bias: the belief was just set from the vehicle's own attitude."""
    P = b.P.copy()
    var = o.sigma_attitude_bias_rad**2
    P[ATT_BIAS, :] = P[:, ATT_BIAS] = 0.0
    for i in range(2):
        P[ATT_BIAS[i], ATT_BIAS[i]] = var
        P[i, i] += var
        P[i, ATT_BIAS[i]] = P[ATT_BIAS[i], i] = -var
    return b._replace(P=P)


def _levelled(b: Belief, event: Attitude) -> Belief:
    return b.changed(levelled_by=event.R_ned_body.matrix, cov_levelled_by=event.cov_body, heading_is_given=True)


def _floats(v: F64) -> Vec3:
    x, y, z = v.tolist()
    return x, y, z


def _set_by(b: Belief, event: Attitude, params: FilterParams) -> tuple[Belief, Outcome]:
    """Set the attitude of a belief at the event's instant outright: the first gives a heading, or the belief's own diverged."""
    o, R = params.options, event.R_ned_body.matrix
    given = b.heading_is_given
    b = _set_attitude(b, R, o) if given else _turned_to(b, R, o)
    return _levelled(_correlated(b, o), event), Outcome(Verdict.FUSED)


def _turned_to(b: Belief, R: F64, o: EkfOptions) -> Belief:
    """Rotate the whole belief about the vertical to a heading that is now known, and set the attitude."""
    angle = so3.heading(R) - so3.heading(b.R)
    Z = so3.about_down(angle)
    T = np.eye(N)
    T[POS_REL, POS_REL] = T[VEL, VEL] = Z
    for part in WAVES[:3].T:
        T[np.ix_(part, part)] = Z
    T[VESSEL_VEL, VESSEL_VEL] = Z[:2, :2]
    x = T.dot(b.x)
    x[PAD_YAW] = wrap_pi(float(x[PAD_YAW]) + angle)
    P = T.dot(b.P).dot(T.T)
    b = b._replace(x=x, P=0.5 * (P + P.T), ins_p=Z.dot(b.ins_p), ins_v=Z.dot(b.ins_v))
    return _set_attitude(b, R, o)


def _set_attitude(b: Belief, R: F64, o: EkfOptions) -> Belief:
    """Replace the attitude outright: the error of the old one is too large for the small-angle approximation."""
    P = b.P.copy()
    P[ATT_ERR, :] = P[:, ATT_ERR] = 0.0
    down = R.T[:, 2]
    along = np.outer(down, down)
    P[ATT_ERR, ATT_ERR] = o.sigma_initial_tilt_rad**2 * (np.eye(3) - along) + o.sigma_initial_heading_rad**2 * along
    return b._replace(R=R, R_cov=R, P=P)


_RANK = {Imu: 0, Attitude: 1, BodyVelocity: 2, Range: 3, Baro: 4, VesselReport: 5, Sighting: 6}


Key = tuple[int, int, int, str]
"""Instant in ns, rank of the type, sequence number, method: they order events in the same way for every order of arrival."""
_CHUNK = 32
_ROW_OVER_KEPT = 4
"""Length of a row over the number of its beliefs that are left, from which these are copied and the row is freed."""


class Entry(Struct, frozen=True):
    """An event in the history."""

    key: Key
    event: Event
    record: PackedEvent
    """The event as the core reads it."""


class Node(NamedTuple):
    """An event and the belief after it."""

    entry: Entry
    row: Sequence[PackedBelief | None]
    """The beliefs after the events that were processed together, as the core holds them; None before the first attitude."""
    at: int
    """Index of the event after this one."""

    @property
    def key(self) -> Key:
        """Place of the event in the history."""
        return self.entry.key

    @property
    def event(self) -> Event:
        """The event."""
        return self.entry.event

    @property
    def packed(self) -> PackedBelief | None:
        """The belief after the event as the core holds it, or None before the first attitude."""
        return self.row[self.at]

    @property
    def after(self) -> Belief | None:
        """The belief after the event, or None before the first attitude."""
        packed = self.packed
        return None if packed is None else packed.belief


_Place = tuple[Entry, Sequence[PackedBelief | None], int]
"""A `Node` as the history keeps it. A late sighting makes a hundred of them, and plain tuples take a tenth of the time."""
Chunks = tuple[tuple[_Place, ...], ...]


class Leap(NamedTuple):
    """Consecutive events whose times of reception agree with one another but not with the earlier ones."""

    received_at: int
    """Time of reception of the newest of them, ns."""
    n: int
    """Number of these events."""


class History(NamedTuple):
    """The recent events and the beliefs after them."""

    base: PackedBelief | None = None
    """The belief before the first node."""
    chunks: Chunks = ()
    """The events, oldest first, by at most `_CHUNK` together: one more event copies one chunk and not all events."""
    forgotten: int = -1
    """Instant of the newest event that was dropped, ns; -1 if none was."""
    received_at: int = -1
    """The latest time of reception, ns; -1 before the first event."""
    leapt: Leap | None = None
    """The consecutive events whose time of reception is far from `received_at`, if there are any."""

    @property
    def nodes(self) -> tuple[Node, ...]:
        """The events, oldest first."""
        return tuple(starmap(Node, chain.from_iterable(self.chunks)))

    def newest(self) -> Belief | None:
        """Return the belief after the last event, or None before the first attitude."""
        packed = _after(self.chunks, self.base)
        return None if packed is None else packed.belief

    def before(self, t: int) -> PackedBelief | None:
        """Return the belief after the last event not later than `t` (ns), or None if the history does not reach back so far."""
        for chunk in reversed(self.chunks):
            if chunk[0][0].key[0] <= t:
                return next(row[at] for entry, row, at in reversed(chunk) if entry.key[0] <= t)
        return self.base if self.base is not None and self.base.t <= t else None


def put(history: History, event: Event, params: FilterParams) -> tuple[History, FusionResult]:
    """Insert one event at its instant and process it and every later event of the history.

    Returns:
        The next history and the result of this event.

    Raises:
        TypeError: the event is not a measurement.
    """
    rank = _RANK.get(type(event))
    if rank is None:
        raise TypeError(f"the filter takes samples and sightings, not {type(event).__name__}")
    stamp, o = event.stamp, params.options
    leap_ns = round(o.leap_s * 1e9)
    if history.received_at >= 0 and abs(stamp.received_at - history.received_at) > leap_ns:
        # One wrong stamp must not make all later events too old; when several agree, the clock itself has leapt.
        before = history.leapt
        n = before.n + 1 if before is not None and abs(stamp.received_at - before.received_at) <= leap_ns else 1
        if n < o.leap_count:
            verdict = Verdict.TOO_NEW if stamp.received_at > history.received_at else Verdict.TOO_OLD
            return history._replace(leapt=Leap(stamp.received_at, n)), result(event, Outcome(verdict))
        history = history._replace(leapt=None) if stamp.received_at > history.received_at else History()
    elif history.leapt is not None:
        history = history._replace(leapt=None)
    received_at = max(history.received_at, stamp.received_at)
    t = stamp.measured_at
    if t > received_at + round(o.max_ahead_s * 1e9):
        return history._replace(received_at=received_at), result(event, Outcome(Verdict.TOO_NEW))
    if t <= history.forgotten:
        return history._replace(received_at=received_at), result(event, Outcome(Verdict.TOO_OLD))
    key = _key(event, rank)
    chunks, later = _split(history.chunks, key)
    history, outcomes = _extended(history, chunks, [Entry(key, event, packed_event(event)), *later], 1, received_at, params)
    return history, result(event, outcomes[0])


def put_all(history: History, events: Sequence[Event], params: FilterParams) -> tuple[History, Sequence[FusionResult]]:
    """Insert events in the order of their reception, as `put` does one by one.

    What follows the history in its order is processed in one row: most of the time that one sample takes is spent around it.
    """
    results: list[FusionResult] = []
    while len(results) < len(events):
        entries, received_at = _in_order(history, events[len(results) :], params)
        if len(entries) > 1:
            history, outcomes = _extended(history, history.chunks, entries, len(entries), received_at, params)
            if len(entries) == len(events):
                return history, Late(len(events), partial(_results, entries, outcomes))
            results += _results(entries, outcomes)
        else:
            history, one = put(history, events[len(results)], params)
            results.append(one)
    return history, results


def _results(entries: list[Entry], outcomes: Sequence[Outcome]) -> list[FusionResult]:
    return [result(entry.event, outcome) for entry, outcome in zip(entries, outcomes, strict=True)]


def _in_order(history: History, events: Sequence[Event], params: FilterParams) -> tuple[list[Entry], int]:
    """Return the first events as far as each belongs at the history's end, and the latest time of reception with them."""
    entries: list[Entry] = []
    received_at = history.received_at
    if len(events) < 2 or not history.chunks or history.leapt is not None:
        return entries, received_at
    o, last = params.options, history.chunks[-1][-1][0].key
    leap_ns, ahead_ns = round(o.leap_s * 1e9), round(o.max_ahead_s * 1e9)
    for event in events:
        rank, stamp = _RANK.get(type(event)), event.stamp
        if rank is None or abs(stamp.received_at - received_at) > leap_ns:
            break
        key, latest = _key(event, rank), max(received_at, stamp.received_at)
        if key < last or key[0] > latest + ahead_ns:
            break
        entries.append(Entry(key, event, packed_event(event)))
        last, received_at = key, latest
    return entries, received_at


def _key(event: Event, rank: int) -> Key:
    t = event.stamp.measured_at
    return (t, rank, event.seq, event.method) if type(event) is Sighting else (t, rank, 0, "")


def _extended(
    history: History, chunks: Chunks, entries: list[Entry], wanted: int, received_at: int, params: FilterParams
) -> tuple[History, Sequence[Outcome]]:
    """Return the history whose chunks go on with these events, and the outcomes of the first `wanted` of them."""
    again, outcomes = _processed(_after(chunks, history.base), entries, wanted, params)
    chunks = _joined(chunks, again)
    oldest = chunks[-1][-1][0].key[0] - round(params.options.history_s * 1e9)
    base, chunks, forgotten = _trimmed(history.base, chunks, history.forgotten, oldest)
    return History(base, chunks, forgotten, received_at, history.leapt), outcomes


def _after(chunks: Chunks, base: PackedBelief | None) -> PackedBelief | None:
    """Return the belief after the last event."""
    if not chunks:
        return base
    _, row, at = chunks[-1][-1]
    return row[at]


def _split(chunks: Chunks, key: Key) -> tuple[Chunks, list[Entry]]:
    """Return the chunks up to a key, and the later events."""
    later: list[Entry] = []
    while chunks and chunks[-1][-1][0].key > key:
        last = chunks[-1]
        i = len(last) - 1
        while i > 0 and last[i - 1][0].key > key:
            i -= 1
        later[:0] = [entry for entry, _, _ in last[i:]]
        chunks = (*chunks[:-1], last[:i]) if i > 0 else chunks[:-1]
    return _compact(chunks), later


def _compact(chunks: Chunks) -> Chunks:
    """Return the chunks without the memory of a long row with few beliefs left.

    The beliefs of a row share their memory. Of samples that are all late, each leaves one belief of a row as long as the history.
    """
    if not chunks:
        return chunks
    _, row, at = chunks[-1][-1]
    if not isinstance(row, Followed) or len(row) < _ROW_OVER_KEPT * (at + 1):
        return chunks
    own = row.first(at + 1)
    out = list(chunks)
    for i in reversed(range(len(out))):
        if out[i][-1][1] is not row:
            break
        out[i] = tuple((entry, own if of is row else of, k) for entry, of, k in out[i])
    return tuple(out)


def _joined(chunks: Chunks, nodes: list[_Place]) -> Chunks:
    """Return the chunks with these nodes after them."""
    if chunks and len(chunks[-1]) < _CHUNK:
        chunks, nodes = chunks[:-1], [*chunks[-1], *nodes]
    return (*chunks, *[tuple(nodes[i : i + _CHUNK]) for i in range(0, len(nodes), _CHUNK)])


def _trimmed(base: PackedBelief | None, chunks: Chunks, forgotten: int, oldest: int) -> tuple[PackedBelief | None, Chunks, int]:
    """Return base, chunks and the instant of the newest event dropped, without the events before the instant `oldest`, ns."""
    while chunks[0][0][0].key[0] < oldest:
        first = chunks[0]
        gone = 1
        while gone < len(first) and first[gone][0].key[0] < oldest:
            gone += 1
        last, row, at = first[gone - 1]
        base, forgotten = row[at], last.key[0]
        chunks = chunks[1:] if gone == len(first) else (first[gone:], *chunks[1:])
    return base, chunks, forgotten


def _processed(
    packed: PackedBelief | None, entries: list[Entry], wanted: int, params: FilterParams
) -> tuple[list[_Place], Sequence[Outcome]]:
    """Return the events with the beliefs after them, and the outcomes of the first `wanted` events.

    The core processes events in a row; what begins a belief, and an attitude that sets one outright, stop it.
    """
    made: list[_Place] = []
    outcomes: list[Outcome] = []
    while len(made) < len(entries):
        rest = entries[len(made) :]
        followed: Sequence[PackedBelief | None] = ()
        if packed is not None:
            row = packed.follow(params, [entry.record for entry in rest])
            if len(row) == len(entries):
                return list(zip(entries, repeat(row), range(len(row)), strict=False)), row.outcomes(wanted)
            if len(outcomes) < wanted and row:
                outcomes += row.outcomes(min(len(row), wanted - len(outcomes)))
            followed = row
        if not followed:
            b, first = process_event(None if packed is None else packed.belief, rest[0].event, params)
            followed = [None if b is None else PackedBelief.of(b)]
            if len(outcomes) < wanted:
                outcomes.append(first)
        done = len(followed)
        made += zip(rest, repeat(followed), range(done), strict=False)
        packed = followed[done - 1]
    return made, outcomes
