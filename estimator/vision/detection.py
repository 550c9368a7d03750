"""The detection of the pad in one frame, as a value: recorders and pages read it without vision, which takes long to load."""

from collections.abc import Mapping

from msgspec import Struct

from estimator.contracts.estimates import Method, Sighting


class Opinions(Struct, frozen=True):
    """What was said of the candidate that a detection comes from, where a second opinion was asked."""

    verified: float
    """Confidence of the verification alone, 0..1."""
    learned: float
    """Confidence of the trained network, 0..1; it can lower the other one."""


class Detection(Struct, frozen=True, eq=False):
    """The detection of the pad in one frame."""

    selected: Sighting | None
    """The chosen method's sighting with `method` "selected"; None if there is none. If both show, the arrow resolves an ambiguous
    heading. A fresh belief does not exclude its place.
    """
    chosen: Method | None
    methods: Mapping[Method, Sighting | None]
    """The sighting of every method that was tried."""
    opinions: Opinions | None = None
    """The two opinions on the best registration; None if the second was not asked."""
    elsewhere: Sighting | None = None
    """What is surer than `selected`, or all that there is, in a place that a fresh belief excludes: another pad, or the tracked
    one if the belief is wrong. It is for the guard to judge.
    """
