"""Identify the vehicle's response in flight, and decide which one the control law flies by.

Every second or two the newest `_WINDOW_S` of commanded and reported tilt are fitted, beginning from the fit before. A fit whose
delay is sure to `known_s` and within `CONTRADICTION_S` of the delay in use confirms it. One that is longer by more than that and
by more than three standard deviations takes its place. Either counts when the next fit says the same; what lies between decides
nothing. A fit whose model is not the vehicle's counts for nothing, nor one whose search is not at its end: the response in use
stays. Two fits in a row that are sure of a longer delay than can be flown with are no response but a fault (`late_s`): the loop
swings about the pad and never comes to the gate.

Frequency and damping are of the same fits. Where two in a row are sure of other ones than are flown by, gains for these take
over: as stiff as the margins allow for all that the flight leaves possible (`shape_of`).

No delay shorter than the file's is flown with: the loop of its gains stands every shorter one, and in a loop that disturbances
drive the fit errs that way.

Commands count from guidance's decision and are held until the next one, reports from the instant of their measurement. Where we
requested no tilt, near the deck, or while the vehicle flies by another's mode, its own tilt stands in for the command, and
nothing is compared until the response to it is over.
"""

import math
from functools import lru_cache

import numpy as np
from msgspec import Struct, structs

from companion.base.mission import CONTACT_INTENDED, GROUND, State
from companion.base.observer import AS_FILED, ResponseInUse, ResponseState, TiltShape
from companion.guidance.law.flown_course import Track, asked_lean, course_of
from companion.guidance.law.margins import keeps_margins
from companion.guidance.law.response_fit import STEP_S, FlightCourse, TiltFit, fit_tilt
from companion.settings.guidance import GuidanceOptions, TiltResponse, within
from estimator.contracts.commands import Command
from estimator.contracts.geometry import F64
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp

CONTRADICTION_S = 0.04
"""A difference of the delay up to this is ignored, s: the margins tolerate it."""
DELAY_MAX_S = 0.4
"""Longest delay that is flown with, s: the margin of 60 ms is kept up to it (docs/guidance.md)."""
_SURELY = 2.0
"""Standard deviations that a delay has to be beyond it."""
_WINDOW_S = 12.0  # length of the newest course that is fitted
_EACH_S = 1.0  # time between two fits
_EACH_KNOWN_S = 2.0  # the same while delay and frequency are known and not doubted
_STEPS = 2
"""Steps of the search in each fit: the next one goes on from there."""
_APART_S = 0.008
"""Reports that follow closer than this are left out, s."""
_REPORTS_MAX = 500
"""Number of reports that are kept between two fits."""
_LATE_S = 1.0
"""Reports that are older than this on arrival are left out, s."""
_EXPLAINED = 0.7
"""Least share of the reported motion that a fit has to explain."""
_GAIN_OFF = 0.35
"""A vehicle that flies so much less or more than commanded is at a limit of its own, or uses other units."""
_COURSE_OFF_S = 0.15
"""A tilt that follows by this much slower or quicker than what is flown by, beside the delay, tells no delay, s."""
_SHAPE_SURELY = 2.5  # standard deviations that a shape has to be beyond the one that is flown by (docs/decisions/response.md)
_BETTER = 0.5
"""A shape that is known this much better is looked at again: its gains may be stiffer."""


_SOFTER = (1.0, 1.25, 1.6, 2.0, 2.6, 10.0 / 3.0)
"""Factors by which the place may weigh less; the last one is that of a response which is only assumed."""
_SHAPE_STEPS = np.array([0.05, 0.1])
"""Steps in which frequency and damping are distinguished, as natural logarithms."""


def shaped(given: TiltResponse, frequency: float, damping: float) -> TiltResponse:
    """Return the response of a file with another frequency and damping, by factors."""
    w, z = within(given.frequency_rad_s * frequency, given.damping * damping)
    return structs.replace(given, frequency_rad_s=w, damping=z)


def shape_of(given: TiltResponse, found: F64, cov: F64) -> TiltShape:
    """Return the shape to fly by.

    Args:
        given: the response of the vehicle's file.
        found: logarithms of the factors of frequency and damping, (2,).
        cov: covariance of these, (2, 2).
    """
    frequency, damping = np.exp(_SHAPE_STEPS * np.round(found / _SHAPE_STEPS)).tolist()
    shape = TiltShape(frequency, damping, sigma=max(0.01, round(math.sqrt(float(cov[0, 0])), 2)))
    return shape._replace(softer=_softer(given, shape))


@lru_cache(maxsize=256)
def _softer(given: TiltResponse, shape: TiltShape) -> float:
    """Return the least factor that keeps the margins with the vehicle as it was found and as slow as gains assume it."""
    assumed = shaped(given, shape.slow, shape.damping)
    believed = assumed, shaped(given, min(1.0, shape.frequency), shape.damping)
    return next((one for one in _SOFTER[:-1] if keeps_margins(assumed, believed, one)), _SOFTER[-1])


_SHAPE_SIGMAS = np.array([0.1, 0.2])
"""Standard deviations up to which frequency and damping are known, as natural logarithms."""
_SHAPE_OFF = np.array([0.12, 0.3])
"""Differences up to which they are ignored: the margins tolerate them."""
_SHAPE_MOST = np.log([2.5, 2.5])
"""A vehicle beyond these is not of the file's kind at all."""


class ResponseWatch(Struct, frozen=True, eq=False):
    """The memory of the identification."""

    given: TiltResponse
    in_use: ResponseInUse
    fit: TiltFit | None = None
    doubt: ResponseInUse | None = None
    """Contradiction of the newest fit to the response in use."""
    late_s: float | None = None
    """The delay, where it is too long to fly with, s; None otherwise."""
    late_doubt: bool = False
    """True if the newest fit reports it."""
    shape: TiltShape = AS_FILED
    """Frequency and damping that are flown by."""
    shape_doubt: F64 | None = None
    """Contradiction of the newest fit to these: logarithms of their factors, (2,)."""
    asked: tuple[tuple[float, float, float], ...] = ()
    reported: tuple[tuple[float, float, float], ...] = ()
    """Instants, s, and tilt forward and right, m/s^2, since the newest fit."""
    asked_before: Track | None = None
    reported_before: Track | None = None
    """Commanded and reported tilt from before the newest fit."""
    stamp_sigma_s: float = 0.0
    due: MonoNs = MonoNs(0)


def begun(given: TiltResponse, known_s: float) -> ResponseWatch:
    """Return the memory before the first flight.

    Args:
        given: the response of the vehicle's file.
        known_s: standard deviation up to which a delay counts as known.
    """
    sigma = given.delay_sigma_s
    state = ResponseState.ASSUMED if sigma is None or sigma > known_s else ResponseState.KNOWN
    return ResponseWatch(given, ResponseInUse(state, given.delay_s, sigma))


def landed(watch: ResponseWatch) -> ResponseWatch:
    """Return the memory for another flight: what is known stays, the courses begin again."""
    return ResponseWatch(
        watch.given, watch.in_use, watch.fit, shape=watch.shape, stamp_sigma_s=watch.stamp_sigma_s, due=watch.due
    )


def reported(watch: ResponseWatch, stamp: Stamp, lean: tuple[float, float]) -> ResponseWatch:
    """Take a reported tilt, m/s^2 forward and right."""
    t = stamp.measured_at / NS_PER_S
    newest = watch.reported[-1][0] if watch.reported else -math.inf
    if watch.reported_before is not None and not watch.reported:
        newest = float(watch.reported_before.t_s[-1])
    if not t - newest >= _APART_S or not 0.0 <= stamp.received_at / NS_PER_S - t <= _LATE_S:
        return watch
    rows = (*watch.reported, (t, *lean))[-_REPORTS_MAX:]
    return structs.replace(watch, reported=rows, stamp_sigma_s=stamp.sigma_s)


def asked(watch: ResponseWatch, now: MonoNs, command: Command | None, known_s: float) -> ResponseWatch:
    """Take the command of a guidance cycle, and fit when it is time.

    Args:
        command: what was commanded in flight; None if the vehicle stands, or is not commanded.
        known_s: standard deviation up to which a delay counts as known.
    """
    watch = structs.replace(watch, asked=(*watch.asked, (now / NS_PER_S, *asked_lean(command))))
    if now < watch.due:
        return watch
    since = now / NS_PER_S - _WINDOW_S
    u, y = _appended(watch.asked_before, watch.asked, since), _appended(watch.reported_before, watch.reported, since)
    undoubted = watch.doubt is None and watch.shape_doubt is None
    calm = undoubted and watch.in_use.state is not ResponseState.ASSUMED and _tells_shape(watch.fit)
    due = MonoNs(now + round((_EACH_KNOWN_S if calm else _EACH_S) * NS_PER_S))
    watch = structs.replace(watch, asked=(), reported=(), asked_before=u, reported_before=y, due=due)
    course = None if u is None or y is None else course_of(u, y, watch.stamp_sigma_s)
    return watch if course is None else _fitted(watch, course, known_s)


def _fitted(watch: ResponseWatch, course: FlightCourse, known_s: float) -> ResponseWatch:
    # The same samples once more are no second witness.
    fresh = course.counts[-round(_EACH_S / STEP_S) :].any()
    fit = fit_tilt(course, watch.given, begin=watch.fit, steps=_STEPS) if fresh else None
    if fit is None:
        return watch
    delay_s, explains = fit.response.delay_s, _explains(course, fit)
    flown = shaped(watch.given, watch.shape.frequency, watch.shape.damping)
    late = delay_s - _SURELY * fit.delay_sigma_s > DELAY_MAX_S and explains and _alike(flown, fit)
    watch = structs.replace(watch, fit=fit, late_doubt=late, late_s=delay_s if late and watch.late_doubt else None)
    watch = _reshaped(watch, fit, known=explains and fit.delay_sigma_s <= known_s)
    # It is good enough to fly by if it answers as what is flown by, only later.
    trusted = 0.0 < delay_s <= DELAY_MAX_S and explains and _alike(flown, fit)
    says = judged(watch.in_use, watch.given, fit, known_s) if trusted else watch.in_use
    if says is watch.in_use:
        return structs.replace(watch, doubt=None)
    agreed = watch.doubt is not None and watch.doubt.state is says.state
    if agreed and watch.doubt is not None and abs(watch.doubt.delay_s - says.delay_s) <= CONTRADICTION_S:
        return structs.replace(watch, in_use=says, doubt=None)
    return structs.replace(watch, doubt=says)


def _tells_shape(fit: TiltFit | None) -> bool:
    return fit is not None and bool(np.all(np.sqrt(np.diagonal(fit.fitted.cov)[1:3]) <= _SHAPE_SIGMAS))


def _reshaped(watch: ResponseWatch, fit: TiltFit, *, known: bool) -> ResponseWatch:
    """Return the memory after what a fit says of frequency and damping."""
    found = fit.fitted.values[1:3] - np.log([watch.given.frequency_rad_s, watch.given.damping])
    cov = fit.fitted.cov[1:3, 1:3]
    sigmas = np.sqrt(np.diagonal(cov))
    sure = known and _tells_shape(fit) and bool(np.all(np.abs(found) <= _SHAPE_MOST))
    off = np.abs(found - np.log([watch.shape.frequency, watch.shape.damping]))
    other = bool(np.any(off > np.maximum(_SHAPE_OFF, _SHAPE_SURELY * sigmas)))
    better = watch.shape != AS_FILED and float(sigmas[0]) < _BETTER * watch.shape.sigma
    if not (sure and (other or better)):
        return structs.replace(watch, shape_doubt=None)
    before = watch.shape_doubt
    if before is None or bool(np.any(np.abs(found - before) > _SHAPE_OFF)):
        return structs.replace(watch, shape_doubt=found)
    as_filed = bool(np.all(np.abs(found) <= _SHAPE_OFF))
    return structs.replace(watch, shape=AS_FILED if as_filed else shape_of(watch.given, found, cov), shape_doubt=None)


def judged(in_use: ResponseInUse, given: TiltResponse, fit: TiltFit, known_s: float) -> ResponseInUse:
    """Return the response to fly by after a fit: the one in use itself as long as the fit does not say otherwise."""
    sigma, delay_s = fit.delay_sigma_s, fit.response.delay_s
    off = abs(delay_s - in_use.delay_s)
    if sigma > known_s:
        return in_use
    if off <= CONTRADICTION_S:
        assumed = in_use.state is ResponseState.ASSUMED
        return structs.replace(in_use, state=ResponseState.KNOWN, sigma_s=sigma) if assumed else in_use
    if off <= 3.0 * sigma:
        return in_use
    if abs(delay_s - given.delay_s) <= CONTRADICTION_S:
        return ResponseInUse(ResponseState.KNOWN, given.delay_s, sigma)
    if delay_s < given.delay_s:
        shortened = in_use.state is ResponseState.IDENTIFIED
        return ResponseInUse(ResponseState.ASSUMED, given.delay_s, given.delay_sigma_s) if shortened else in_use
    return ResponseInUse(ResponseState.IDENTIFIED, delay_s, sigma, delay_s - given.delay_s)


def _alike(flown: TiltResponse, fit: TiltFit) -> bool:
    of = fit.response
    return abs((of.slowness_s - of.delay_s) - (flown.slowness_s - flown.delay_s)) <= _COURSE_OFF_S


def _explains(course: FlightCourse, fit: TiltFit) -> bool:
    """Return whether the fit tells most of the motion, and about as much of it as was commanded."""
    if not fit.fitted.settled or abs(fit.gain - 1.0) > _GAIN_OFF:
        return False
    noted = np.asarray((course.reported - fit.fitted.offset)[course.counts])
    moved = float((noted - noted.mean(axis=0)).std())
    return fit.fitted.residual**2 <= (1.0 - _EXPLAINED) * moved**2


def _appended(before: Track | None, rows: tuple[tuple[float, float, float], ...], since_s: float) -> Track | None:
    """Return the track with more rows, without what is older than the window."""
    if not rows:
        return before
    table = np.array(rows)
    t, values = table[:, 0], table[:, 1:]
    if before is not None:
        keep = before.t_s >= since_s
        t, values = np.concatenate([before.t_s[keep], t]), np.concatenate([before.values[keep], values])
    return Track(t, values)


_ON_DECK = (*GROUND, *CONTACT_INTENDED)


class ResponseIdentifier:
    """Identifies the response of one vehicle through all its flights.

    Args:
        given: the response of the vehicle's file.
    """

    def __init__(self, given: TiltResponse, guidance: GuidanceOptions) -> None:
        self._watch = begun(given, guidance.follow_deck.delay_known_s)
        # That the file holds is nothing to tell; that the gains are softer is.
        self._told = self._watch.in_use if self._watch.in_use.state is ResponseState.KNOWN else None
        self.retune(guidance)

    def retune(self, guidance: GuidanceOptions) -> None:
        """Use other settings from now on; what is known stays."""
        # The thesis' controller commands velocities, which do not determine the tilt.
        self._on = guidance.follow_deck.identify and guidance.controller != "pid"
        self._known_s = guidance.follow_deck.delay_known_s

    @property
    def in_use(self) -> ResponseInUse | None:
        """The response to fly by; None if it is not identified."""
        if not self._on:
            return None
        shape, of = self._watch.shape, self._watch.in_use
        return of if shape is AS_FILED else structs.replace(of, shape=shape)

    @property
    def late_s(self) -> float | None:
        """Delay of the vehicle's answer, s, if it is too late to fly; None otherwise."""
        return self._watch.late_s if self._on else None

    def on_attitude(self, stamp: Stamp, lean_m_s2: tuple[float, float]) -> None:
        """Take a reported tilt, as an acceleration forward and right."""
        if self._on:
            self._watch = reported(self._watch, stamp, lean_m_s2)

    def begin(self) -> None:
        """Begin another flight, or landing, with what is known."""
        self._watch = landed(self._watch)

    def on_command(self, now: MonoNs, command: Command | None, state: State, *, flown: bool = True) -> ResponseInUse | None:
        """Take the command of a cycle; return the response in use when it differs from the last reported one, else None.

        Args:
            flown: whether the vehicle flies by commands: its mode is not another one.
        """
        if not self._on:
            return None
        if state is State.TAKEN:
            # It was another's before it reported so, up to a second later.
            self._watch = landed(self._watch)
        on_deck = state in _ON_DECK
        self._watch = asked(self._watch, now, command if flown and not on_deck else None, self._known_s)
        if on_deck or self.in_use == self._told:
            return None
        self._told = self.in_use
        return self._told
