"""Late measurements: a bounded past is kept, a late one is put in at its own instant, and what followed is done again.

The result is the one of having heard everything in order, because what is kept is every event with the belief after it, and
nothing in folding an event depends on when it was heard.
"""

from __future__ import annotations

from typing import NamedTuple

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.fusion import FusionResult
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.ekf.process_event import process_event
from estimator.ekf.propagate import Event, FilterParams, result
from estimator.ekf.state import Belief

_RANK = {Imu: 0, Attitude: 1, BodyVelocity: 2, Range: 3, Baro: 4, VesselReport: 5, Sighting: 6}


class Node(NamedTuple):
    """An event and the belief after it."""

    key: tuple[int, int, int, str]
    """Instant in ns, kind, sequence number, method: one order whatever the order of arrival."""
    event: Event
    after: Belief | None


class Leap(NamedTuple):
    """Events in a row whose times of arrival agree with one another and not with those before."""

    received_at: int
    """ns, of the newest."""
    n: int


class History(NamedTuple):
    """The recent past, oldest first; `base` is the belief before its first node."""

    base: Belief | None = None
    nodes: tuple[Node, ...] = ()
    forgotten: int = -1
    """ns, the newest instant that is no longer kept; -1 none."""
    received_at: int = -1
    """ns, the newest arrival."""
    leapt: Leap | None = None
    """Arrivals in a row that put themselves far from `heard`."""

    def newest(self) -> Belief | None:
        return self.nodes[-1].after if self.nodes else self.base

    def before(self, t: int) -> Belief | None:
        """The belief after the last event not later than `t` (ns)."""
        for node in reversed(self.nodes):
            if node.key[0] <= t:
                return node.after
        return self.base if self.base is not None and self.base.t <= t else None


def put(history: History, event: Event, params: FilterParams) -> tuple[History, FusionResult]:
    """Take one event, late or not.

    Raises:
        TypeError: an object that is no measurement.
    """
    rank = _RANK.get(type(event))
    if rank is None:
        raise TypeError(f"the filter takes samples and sightings, not {type(event).__name__}")
    stamp, o = event.stamp, params.options
    leap_ns = round(o.leap_s * 1e9)
    if history.received_at >= 0 and abs(stamp.received_at - history.received_at) > leap_ns:
        # One wrong stamp must not make everything after it too old; when all agree, it is time that leapt.
        before = history.leapt
        n = before.n + 1 if before is not None and abs(stamp.received_at - before.received_at) <= leap_ns else 1
        if n < o.leap_count:
            verdict = Verdict.TOO_NEW if stamp.received_at > history.received_at else Verdict.TOO_OLD
            return history._replace(leapt=Leap(stamp.received_at, n)), result(event, verdict)
        history = history._replace(leapt=None) if stamp.received_at > history.received_at else History()
    elif history.leapt is not None:
        history = history._replace(leapt=None)
    received_at = max(history.received_at, stamp.received_at)
    t = stamp.measured_at
    if t > received_at + round(o.max_ahead_s * 1e9):
        return history._replace(received_at=received_at), result(event, Verdict.TOO_NEW)
    if t <= history.forgotten:
        return history._replace(received_at=received_at), result(event, Verdict.TOO_OLD)
    key = (t, rank, event.seq, event.method) if isinstance(event, Sighting) else (t, rank, 0, "")
    nodes = history.nodes
    i = len(nodes)
    while i > 0 and nodes[i - 1].key > key:
        i -= 1
    b, outcome = process_event(nodes[i - 1].after if i else history.base, event, params)
    again = [Node(key, event, b)]
    for node in nodes[i:]:
        b, _ = process_event(b, node.event, params)
        again.append(Node(node.key, node.event, b))
    nodes = nodes[:i] + tuple(again)
    return _trimmed(history._replace(nodes=nodes, received_at=received_at), round(o.history_s * 1e9)), outcome


def _trimmed(history: History, span_ns: int) -> History:
    nodes = history.nodes
    oldest = nodes[-1].key[0] - span_ns
    i = 0
    while nodes[i].key[0] < oldest:
        i += 1
    if i == 0:
        return history
    gone = nodes[i - 1]
    return history._replace(base=gone.after, nodes=nodes[i:], forgotten=gone.key[0])
