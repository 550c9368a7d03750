"""Out-of-sequence measurements: insert a late event at the instant when it was measured and re-propagate the later events.

The result equals the one of events received in order: the history keeps every recent event with the belief after it, and
`process_event` does not depend on when an event was received.
"""

from __future__ import annotations

from typing import NamedTuple

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.fusion import FusionResult
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.ekf.outcome import Outcome
from estimator.ekf.packed_belief import PackedBelief, Sample, packed_sample
from estimator.ekf.process_event import process_event
from estimator.ekf.propagate import Event, FilterParams, result
from estimator.ekf.state import Belief

_RANK = {Imu: 0, Attitude: 1, BodyVelocity: 2, Range: 3, Baro: 4, VesselReport: 5, Sighting: 6}


class Node(NamedTuple):
    """An event and the belief after it."""

    key: tuple[int, int, int, str]
    """Sort key (instant in ns, rank of the type, sequence number, method), the same for every order of arrival."""
    event: Event
    sample: bytes | None
    """The event as the core reads it; None if Python processes it."""
    packed: PackedBelief | None
    """The belief after the event as the core holds it; None before the first attitude."""

    @property
    def after(self) -> Belief | None:
        """The belief after the event, or None before the first attitude."""
        return None if self.packed is None else self.packed.belief


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
    nodes: tuple[Node, ...] = ()
    """The events, oldest first."""
    forgotten: int = -1
    """Instant of the newest event that was dropped, ns; -1 if none was."""
    received_at: int = -1
    """The latest time of reception, ns; -1 before the first event."""
    leapt: Leap | None = None
    """The consecutive events whose time of reception is far from `received_at`, if there are any."""

    def newest(self) -> Belief | None:
        """Return the belief after the last event, or None before the first attitude."""
        packed = self.nodes[-1].packed if self.nodes else self.base
        return None if packed is None else packed.belief

    def before(self, t: int) -> PackedBelief | None:
        """Return the belief after the last event not later than `t` (ns), or None if the history does not reach back so far."""
        for node in reversed(self.nodes):
            if node.key[0] <= t:
                return node.packed
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
    key = (t, rank, event.seq, event.method) if isinstance(event, Sighting) else (t, rank, 0, "")
    nodes = history.nodes
    i = len(nodes)
    while i > 0 and nodes[i - 1].key > key:
        i -= 1
    inserted = [Node(key, event, packed_sample(event) if isinstance(event, Sample) else None, None), *nodes[i:]]
    again, outcome = _processed(nodes[i - 1].packed if i else history.base, inserted, params)
    nodes = nodes[:i] + tuple(again)
    history = History(history.base, nodes, history.forgotten, received_at, history.leapt)
    return _trimmed(history, round(o.history_s * 1e9)), result(event, outcome)


def _processed(packed: PackedBelief | None, nodes: list[Node], params: FilterParams) -> tuple[list[Node], Outcome]:
    """Return the nodes with the beliefs after their events, and the outcome of the first event.

    The core processes the vehicle's samples in a row; sightings, vessel reports and what begins a belief stop it.
    """
    made: list[Node] = []
    outcome = None
    while len(made) < len(nodes):
        here, row = len(made), []
        for node in nodes[here:] if packed is not None else ():
            if node.sample is None:
                break
            row.append(node.sample)
        if row and packed is not None:
            followed, first = packed.follow(params.process_noise, row)
            for after, node in zip(followed, nodes[here:], strict=False):
                made.append(Node(node.key, node.event, node.sample, after))
        else:
            followed = []
        if followed:
            packed = followed[-1]
        else:
            node = nodes[here]
            b, first = process_event(None if packed is None else packed.belief, node.event, params)
            packed = None if b is None else PackedBelief.of(b)
            made.append(Node(node.key, node.event, node.sample, packed))
        outcome = outcome or first
    assert outcome is not None
    return made, outcome


def _trimmed(history: History, span_ns: int) -> History:
    nodes = history.nodes
    oldest = nodes[-1].key[0] - span_ns
    i = 0
    while nodes[i].key[0] < oldest:
        i += 1
    if i == 0:
        return history
    gone = nodes[i - 1]
    return history._replace(base=gone.packed, nodes=nodes[i:], forgotten=gone.key[0])
