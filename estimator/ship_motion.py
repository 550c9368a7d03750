"""The ship's motion sensors as witnesses: their delay, noise and trust, found against the camera.

A sensor reports roll, pitch and heave of its own place, late by an unknown time, with a mean of its own. The filter gets the
motion of the pad's centre and about its arrow, without that mean, at the instant when it was true, as certain as the sensor has
proved. The camera proves it: the pad's height as sightings show it, carried by the IMU alone, and the deck's tilt in the
pictures. Neither depends on what the filter made of a sensor, so none can confirm itself. Over a window of sightings a
polynomial takes off what drifts (the IMU's place by a parabola, an attitude by a line), and the rest is compared for each delay
that a sensor may have.
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import Annotated, Literal, get_args

import numpy as np
from msgspec import Struct, structs

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import F64
from estimator.contracts.keys import CheckedOptions, text, tuning
from estimator.contracts.samples import VesselMotion, VesselReport
from estimator.contracts.time import MonoNs, after

Channel = Literal["heave", "tilt"]

_PERIOD_S = 0.19  # Least time between two reports that are fused
_ALIKE = 4.0  # Number of them in a row whose errors are alike and count as one
_SENSORS_MOST = 32  # Sensors that are compared; a ship has a few, and names may be invented
_RECORD_S = 60.0  # Time over which a mean is taken off
_SILENT_S = 5.0  # Time of silence after which another sensor is used
_STUCK_S = 3.0  # Time of repeated bits of one that moved
_DELAYS_S = np.arange(-0.3, 1.31, 0.05)
"""Delays that are compared with the camera."""
_DELAY_MAX_S = 0.6  # The longest of a sensor that is used
_ALLOWED = _DELAYS_S <= _DELAY_MAX_S + 1e-6
_DELAY_S = 0.1  # Delay before any comparison
_SIGMA_DELAY_S = 0.2  # Its standard deviation
_LATE_ODDS = 4.0  # Logarithm of the odds from which on a sensor is too late
_SEEN_HZ = 10.0  # Rate of the sightings that are compared
_GAP_S = 1.0  # Their longest gap
_WINDOW_S = 10.0  # Their longest time
_LEAST_S = 1.5  # Their least time
_SETTLES_S = 2.0  # Time in which an attitude settles after the beginning of all: until then the IMU carries a height badly
_MEAN_OF = 3  # Number of sightings whose mean is compared, as a picture's noise is no motion
_SHORT_S = 4.0  # Time for which an attitude errs evenly
_JUDGES_S = 0.25  # Time between two comparisons
_MEMORY_S = 60.0  # Time over which they fade
_AGAIN_S = 20.0  # Time of agreement that forgives
_FALSE = {0.0: ("", 3.0), -1.0: (", and its sign is wrong", 3.0), 2.0: (", and it is double", 8.0)}
"""Multiples of the truth that a false sensor reports, with words and the logarithm of the odds from which on it is believed."""
_CONFIRMED = 3.0  # Log odds that confirm a sensor
_PROVEN_S = 1.0  # Time for which they last before it is fused in sight
_IN_SIGHT_S = 2.0  # Time for which a sighting counts as sight
_FLOOR = {"heave": 0.04, "tilt": math.radians(0.3)}
"""A size of a motion that shows, m and rad."""
_ERRORS = {"heave": (0.012, 0.02, 0.012, 0.01), "tilt": tuple(math.radians(one) for one in (0.1, 0.15, 0.25, 0.5))}
"""Standard deviations (m, rad) of a good sensor's white error and of the one that is alike for a while, and the camera's two: the
latter by the IMU's drift, or by the vehicle's attitude when it leans."""
_ALIKE_S = 3.0  # Time for which a sensor's error is alike
_LEANS_S = 1.0  # Time for which the camera's is
_OF_SIZE = 0.03  # Share of the motion in the sensor's error
_SCALE = 0.1  # Error of its scale
_GOOD = {"heave": 0.05, "tilt": math.radians(0.2)}
"""Standard deviation before any comparison, m and rad."""
_GOOD_SHARE = 0.05  # The same as a share: makers of motion sensors state 5 % of the heave
_MEAN_FROM_S = 20.0  # Time from which a heave's mean is judged
_SLOW_S = 30.0  # Time from which its slow part is
_WANDER_M = 0.15  # Size of either that a sea may have
_FASTEST = {"heave": 3.0, "tilt": math.radians(60.0)}
"""Rates that no ship reaches, m/s and rad/s: the record begins again."""
_SLACK = {"heave": 0.3, "tilt": math.radians(3.0)}
"""A step beside that, m and rad."""
_JOLT = 1.5  # A manoeuvre's change by the largest that is usual
_JOLT_M_S2 = 0.15  # Its least acceleration
_JOLT_RAD_S = 0.02  # Its least rate
_JOLTED_S = 0.4  # Time for which it counts
_JOLT_MEAN_S = 0.3  # Time over which a signal's mean goes with it
_JOLT_NEW_S = 0.5  # Time from which on a change is usual
_JOLT_USUAL_S = 20.0  # Time over which it fades
_JOLT_KNOWN_S = 3.0  # Time until it is known


def between(known: F64, values: F64, t: F64) -> F64:
    """Return a motion, (n, k), at instants, (n,), by its values, (m, k), at known ones, (m,): by cubic Hermite splines.

    A line would cut the crests of waves that are sampled once a second.
    """
    slope = np.gradient(values, known, axis=0)
    k = np.clip(np.searchsorted(known, t) - 1, 0, known.size - 2)
    span = (known[k + 1] - known[k])[:, None]
    s = (t - known[k])[:, None] / span
    h = s * s * (3.0 - 2.0 * s)
    bends = s * (1.0 - s) ** 2 * slope[k] - s * s * (1.0 - s) * slope[k + 1]
    made: F64 = (1.0 - h) * values[k] + h * values[k + 1] + span * bends
    return made


def wander(heave: F64, spans_s: float) -> tuple[float, float, float]:
    """Return the waves in a heave, (n,), up to a minute long, what is slower, and by how much it is none of a sea: above 1 it is.

    A mean, or a part slower than any swell, is none: a sensor's own high-pass leaves neither. Both are standard deviations, m.
    """
    mean_m, t = abs(float(np.mean(heave))), np.linspace(-1.0, 1.0, heave.size)
    slow = np.polynomial.chebyshev.chebval(t, np.polynomial.chebyshev.chebfit(t, heave, round(spans_s / _MEAN_FROM_S)))
    waves_m, slow_m = float(np.std(heave - slow)), float(np.std(slow)) if spans_s >= _SLOW_S else 0.0
    worst = max(mean_m / max(_WANDER_M, 0.5 * float(np.std(heave))), slow_m / max(_WANDER_M, waves_m))
    return waves_m, max(mean_m, slow_m), worst


class ShipMotionOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The ship's motion sensor (roll, pitch, heave): where it is, and which of several it is.

    Raises:
        ValueError: a number outside its range.
    """

    sensor: Annotated[
        str,
        text("the sensor to use, by its name on the page; best for the one that agrees best with the camera, none for none", 64),
    ] = "best"
    forward_m: Annotated[
        float, tuning("place of the motion sensor from the pad's centre, towards her bow", "m", -400.0, 400.0, public=True)
    ] = 0.0
    right_m: Annotated[float, tuning("the same to starboard", "m", -100.0, 100.0, public=True)] = 0.0


class Standing(Struct, frozen=True):
    """The worth of a sensor, as far as it was compared with the camera."""

    sensor: str
    delay_s: float
    sigma_delay_s: float
    noise_m: float | None
    noise_rad: float | None
    """Standard deviations of its heave, and of its roll and pitch; None if it reports none."""
    used: tuple[Channel, ...]
    faults: tuple[str, ...]
    """Reasons why channels are left out, in words."""

    @property
    def text(self) -> str:
        """It in words for a person."""
        noise = [] if self.noise_m is None else [f"heave to {100.0 * self.noise_m:.0f} cm"]
        noise += [] if self.noise_rad is None else [f"tilt to {math.degrees(self.noise_rad):.1f} deg"]
        used = f"used for {' and '.join(self.used)}" if self.used else "not used"
        return ", ".join((used, f"{1e3 * self.delay_s:.0f} ms late", *noise, *self.faults))


class _Channel:
    """One kind of number of one sensor: its heave, or its roll and pitch."""

    def __init__(self, kind: Channel) -> None:
        self.kind: Channel = kind
        self.t: deque[float] = deque()
        self.values: deque[tuple[float, ...]] = deque()
        self.mean: tuple[float, ...] = (0.0,) * (1 if kind == "heave" else 2)
        self.size = self.sigma_mean = 0.0
        self.fault, self.doubted = "", False
        self.against_s = self.n = self.squares = self.proof_s = 0.0
        self.fused_at = self.changed_at = self.summed_at = -math.inf

    def add(self, t: float, now: tuple[float, ...]) -> Verdict | None:
        if self.t and t - self.t[-1] <= _SILENT_S:
            if t <= self.t[-1]:
                return Verdict.TOO_OLD
            if now != self.values[-1]:
                self.changed_at, self.fault = t, "" if "repeat" in self.fault else self.fault
            elif self.size > 0.5 * _FLOOR[self.kind] and t - max(self.changed_at, self.t[0]) > _STUCK_S:
                self.fault = f"it repeats its {self.kind}"
                return Verdict.FROZEN
            if math.dist(now, self.values[-1]) > _SLACK[self.kind] + _FASTEST[self.kind] * (t - self.t[-1]):
                self._restart()
                return Verdict.IMPOSSIBLE
        elif self.t:
            self._restart()
        self.t.append(t)
        self.values.append(now)
        while t - self.t[0] > _RECORD_S:
            self.t.popleft()
            self.values.popleft()
        if t - self.summed_at >= 2.0 * _JUDGES_S:
            self.summed_at = t
            self._sum_up()
        return None

    def _restart(self) -> None:
        self.t.clear()
        self.values.clear()
        self.changed_at = -math.inf

    def _sum_up(self) -> None:
        """Take mean and size of the record, and judge whether a heave is one of waves."""
        values = np.array(self.values)
        centre = values.mean(axis=0)
        self.mean = tuple(centre.tolist())
        self.size = float(np.sqrt(np.mean((values - centre) ** 2)))
        spans_s = self.t[-1] - self.t[0]
        # The mean of a sine over T has at most 1 / (w T) of its size; a short record shows no mean at all.
        size = max(self.size, 2.0 * _FLOOR[self.kind] if spans_s < _LEAST_S else 0.0)
        self.sigma_mean = size * min(1.0, 3.0 / max(spans_s, 1e-3))
        if self.kind == "heave" and spans_s >= _MEAN_FROM_S:
            _, size_m, worst = wander(values[:, 0], spans_s)
            if worst > 1.0:
                self.fault, self.against_s = f"its heave wanders by {size_m:.1f} m more slowly than a sea does", _AGAIN_S
            elif "wanders" in self.fault and worst < 0.5:
                self.fault = ""

    def judge(self, differs: float, odds: dict[float, float], since_s: float) -> None:
        """Weigh one comparison: how far sensor and camera differ, and the logarithms of the odds that the sensor is false."""
        fade = math.exp(-since_s / _MEMORY_S)
        self.n, self.squares = fade * self.n + since_s, fade * self.squares + since_s * differs**2
        self.proof_s = fade * self.proof_s + (since_s if max(odds[0.0], odds[-1.0]) < -_CONFIRMED else 0.0)
        against = [g for g, (_, enough) in _FALSE.items() if odds[g] > enough]
        if not against:
            self.doubted, self.against_s = False, max(0.0, self.against_s - since_s)
            if self.against_s == 0.0 and "camera" in self.fault:
                self.fault = ""
            return
        if self.doubted and not self.fault:
            by = f"{differs:.2f} m" if self.kind == "heave" else f"{math.degrees(differs):.1f} deg"
            self.fault = f"its {self.kind} and the camera differ by {by}{_FALSE[max(against, key=odds.__getitem__)][0]}"
        self.doubted, self.against_s, self.proof_s = True, _AGAIN_S if self.fault else 0.0, 0.0

    @property
    def agrees(self) -> bool:
        return not self.fault and not self.doubted

    @property
    def noise(self) -> float:
        good = math.hypot(_GOOD[self.kind], _GOOD_SHARE * self.size)
        return math.sqrt((5.0 * good**2 + self.squares) / (5.0 + self.n))

    def at(self, t: F64) -> F64:
        """Return the readings, (n, k), at instants within the record."""
        return between(np.array(self.t), np.array(self.values), t)


class _Sensor:
    """One sensor with its channels, its delay, and where it is."""

    def __init__(self, name: str, to_pad_m: tuple[float, float], turn: tuple[float, float]) -> None:
        self.name, self._to_pad_m, (self._c, self._s) = name, to_pad_m, turn
        # By roll and pitch the pad goes so much lower than the sensor.
        self._lever_m = np.array([to_pad_m[1], -to_pad_m[0]])
        self.channels: dict[Channel, _Channel] = {kind: _Channel(kind) for kind in get_args(Channel)}
        self.delay_s, self.sigma_delay_s = _DELAY_S, _SIGMA_DELAY_S
        self.log_odds = np.zeros(_DELAYS_S.size)
        self.late, self.maybe_late = "", False

    def add(self, sample: VesselMotion, t: float) -> Verdict | None:
        verdict = None
        if sample.heave_down_m is not None:
            verdict = self.channels["heave"].add(t, (sample.heave_down_m,))
        if sample.roll_rad is not None and sample.pitch_rad is not None:
            verdict = self.channels["tilt"].add(t, (sample.roll_rad, sample.pitch_rad)) or verdict
        return verdict

    def proven(self, kind: Channel) -> bool:
        """Return whether the camera has agreed for a while, on a deck that it saw move."""
        return self.channels[kind].agrees and self.channels[kind].proof_s >= _PROVEN_S

    def worth(self) -> tuple[bool, float]:
        """Return whether the camera has agreed, and the time of the newest report: what is least is forgotten first."""
        return any(map(self.proven, self.channels)), max((c.t[-1] for c in self.channels.values() if c.t), default=-math.inf)

    def _tilted(self, tilt: F64) -> F64:
        return np.stack([self._c * tilt[:, 0] + self._s * tilt[:, 1], self._c * tilt[:, 1] - self._s * tilt[:, 0]], axis=1)

    def now(self, sample: VesselMotion, t: float, kinds: Sequence[Channel]) -> VesselMotion | None:
        """Return one report as the filter takes it, with the channels that are used and due; None if none is."""
        due = [k for k in kinds if (c := self.channels[k]).t and c.t[-1] == t and t - c.fused_at >= _PERIOD_S]
        if not due:
            return None
        heave, tilt = self.channels["heave"], self.channels["tilt"]
        at = min(sample.stamp.received_at, after(sample.stamp.measured_at, -self.delay_s))
        made = VesselMotion(structs.replace(sample.stamp, measured_at=at), self.name)
        known = bool(tilt.t) and t - tilt.t[-1] < 0.5
        turned = np.array([tilt.values[-1]]) - tilt.mean if known else np.zeros((1, 2))
        for kind in due:
            self.channels[kind].fused_at = t
        if "tilt" in due:
            roll, pitch = self._tilted(turned)[0].tolist()
            made = structs.replace(made, roll_rad=roll, pitch_rad=pitch, sigma_tilt_rad=self._sigma(tilt, sample.sigma_tilt_rad))
        if "heave" in due:
            down = heave.values[-1][0] - heave.mean[0] + float(turned[0] @ self._lever_m)
            of_arm_m = math.hypot(*self._to_pad_m) * (tilt.noise if known else 0.03)
            made = structs.replace(
                made, heave_down_m=down, sigma_heave_m=math.hypot(self._sigma(heave, sample.sigma_heave_m), of_arm_m)
            )
        return made

    def _sigma(self, channel: _Channel, digits: float) -> float:
        # A wave of a size has a rate of about that size a second.
        late = 0.8 * channel.size * self.sigma_delay_s
        return math.sqrt(_ALIKE * (channel.noise**2 + digits**2 + late**2) + channel.sigma_mean**2)

    def compare(self, seen: F64, since_s: float) -> None:
        """Compare (n, 4) instants, the pad downward from anywhere, roll and pitch (nan if not seen) with the record."""
        squares, late = np.zeros(_DELAYS_S.size), 0.0
        for kind, columns in zip(get_args(Channel), ([0, 1], [0, 2, 3]), strict=True):
            there = seen[np.isfinite(seen[:, columns]).all(axis=1)][:, columns]
            if len(there) > 2 * _MEAN_OF and (found := self._odds(kind, there[:, 0], there[:, 1:])) is not None:
                differs, odds, by_late, by_delay = found
                self.channels[kind].judge(differs, odds, since_s)
                if self.channels[kind].agrees:
                    # A vehicle that leans in a manoeuvre errs for as long as a late sensor would: heave is the better clock.
                    squares, late = squares + by_delay, late if kind == "tilt" and self.channels["heave"].t else by_late
        if squares.any():
            self._find_delay(squares, late, since_s)

    def _odds(self, kind: Channel, t: F64, seen: F64) -> tuple[float, dict[float, float], float, F64] | None:
        """Return a good sensor's difference, the logarithms of the odds of false ones and a late one, and its squares by delay.

        Every reading is compared with what was seen a delay before it, both less a polynomial, and whitened. Of each delay the
        readings count from the first one on whose instant was seen; a false sensor is compared by the same ones.
        """
        channel, tilt, bend = self.channels[kind], self.channels["tilt"], 2 if kind == "heave" else int(t[-1] - t[0] >= _SHORT_S)
        steps, mean = np.vander((t - t[0]) / _WINDOW_S, bend + 1), np.full(_MEAN_OF, 1.0 / _MEAN_OF)
        steady = seen - steps @ np.linalg.lstsq(steps, seen, rcond=None)[0]
        t, *steady = (np.convolve(one, mean, "valid") for one in (t, *steady.T))
        read = np.array(channel.t)
        read = read[(np.diff(np.floor(read / _PERIOD_S), prepend=0.0) > 0.0) & (read >= t[0] + _DELAYS_S[0]) & (read <= t[-1])]
        if read.size <= bend + 1:
            return None
        values, lever = channel.at(read) - channel.mean, 0.0
        if kind == "tilt":
            values = self._tilted(values)
        elif any(self._to_pad_m) and len(tilt.t) > 1:
            lever = (tilt.at(read) - tilt.mean) @ self._lever_m[:, None]
        shown = np.stack([np.stack([np.interp(read - d, t, one) for one in steady], axis=1) for d in _DELAYS_S]) - lever
        first, prior = np.searchsorted(read, t[0] + _DELAYS_S), ((_DELAYS_S - _DELAY_S) / _SIGMA_DELAY_S) ** 2
        odds, late, differs = dict.fromkeys(_FALSE, np.full(_DELAYS_S.size, -np.inf)), -math.inf, 0.0
        for begin in np.unique(first).tolist():
            if read.size - begin <= bend + 1 or read[-1] - read[begin] < _LEAST_S:
                break
            known = first <= begin
            flat, of_camera = _whitening(kind, read[begin:], bend, channel.size)
            reported, white = flat @ values[begin:], flat @ shown[:, begin:]
            squares = _squares(reported, 1.0, white)
            good = np.where(known & _ALLOWED, squares + prior, np.inf)
            false = {g: (_squares(reported, g, white) + prior)[known].min() for g in odds}
            false[0.0] = np.sum(reported**2) + values.shape[1] * of_camera
            # A sensor that is noisier than a good one proves less.
            noise = max(1.0, min(good.min(), *false.values()) / reported.size)
            odds = {g: np.where(good < np.inf, np.maximum(odds[g], 0.5 * (good - false[g]) / noise), odds[g]) for g in odds}
            apart = _flat(read[begin:], bend) @ (values[begin:] - shown[int(good.argmin()), begin:])
            differs = float(np.sqrt(np.mean(apart**2)))
            if (known & ~_ALLOWED).any():
                late = max(late, 0.5 * float(good.min() - squares[known & ~_ALLOWED].min()) / noise)
        least = {g: float(found[_ALLOWED].min()) for g, found in odds.items()}
        if math.isinf(least[0.0]):
            return None
        return differs, least, late, np.where(known, squares, squares[known][-1])

    def _find_delay(self, squares: F64, late: float, since_s: float) -> None:
        self.log_odds = math.exp(-since_s / _MEMORY_S) * self.log_odds - 0.5 * since_s / _WINDOW_S * squares
        prior = -0.5 * ((_DELAYS_S - _DELAY_S) / _SIGMA_DELAY_S) ** 2
        if late > _LATE_ODDS and self.maybe_late:
            self.late = f"it is late by {_DELAYS_S[int(squares.argmin())]:.1f} s"
        self.maybe_late = late > _LATE_ODDS
        if self.late and late > 0.0:
            return
        log_odds = self.log_odds + prior
        weight, self.late = np.exp(log_odds - log_odds[_ALLOWED].max()) * _ALLOWED, ""
        weight /= weight.sum()
        self.delay_s = float(weight @ _DELAYS_S)
        self.sigma_delay_s = max(0.02, math.sqrt(float(weight @ (_DELAYS_S - self.delay_s) ** 2)))

    def standing(self, used: tuple[Channel, ...]) -> Standing:
        heave, tilt = [channel.noise if channel.t else None for channel in self.channels.values()]
        faults = tuple(why for why in (self.late, *(channel.fault for channel in self.channels.values())) if why)
        return Standing(self.name, self.delay_s, self.sigma_delay_s, heave, tilt, used, faults)


class ShipMotion:
    """All motion sensors of a ship. Samples and sightings come in the order of their reception.

    Args:
        options: where the sensor is, and which one it is.
        pad_yaw_rad: direction of the pad's arrow from the bow, clockwise from above.
    """

    def __init__(self, options: ShipMotionOptions, pad_yaw_rad: float) -> None:
        self._options = options
        self._to_pad_m = -options.forward_m, -options.right_m
        self._turn = math.cos(pad_yaw_rad), math.sin(pad_yaw_rad)
        self._sensors: dict[str, _Sensor] = {}
        self.reports: bool = False
        self._seen: list[tuple[float, float, float, float]] = []
        self._judged = self._jolted_s = -math.inf
        self._begun = math.inf
        self._felt: dict[str, tuple[float, float, float, deque[tuple[float, float]]]] = {}

    @property
    def lost(self) -> tuple[str, ...]:
        """The sensors that are left out, in words."""
        return tuple(f"the motion sensor {s.sensor}: {why}; flying without it" for s in self.standings() for why in s.faults)

    def standings(self) -> tuple[Standing, ...]:
        """Return what each sensor is worth."""
        return tuple(sensor.standing(self._used(sensor)) for sensor in self._sensors.values())

    def confirmed(self, now: MonoNs) -> bool:
        """Return whether the camera agrees with the fresh heave and tilt of sensors that are used: the deck has two witnesses."""
        best = [(kind, self._best(kind)) for kind in get_args(Channel)] if self.reports else []
        return bool(best) and all(s and s.proven(kind) and 1e-9 * now - s.channels[kind].t[-1] < _IN_SIGHT_S for kind, s in best)

    def reported(self, sample: VesselMotion) -> VesselMotion | Verdict | None:
        """Take one report; return the pad's motion by it, the verdict that refuses it, or None where it is compared only."""
        t = 1e-9 * sample.stamp.measured_at
        sensor = self._sensors.get(sample.sensor)
        if sensor is None:
            if len(self._sensors) >= _SENSORS_MOST:
                del self._sensors[min(self._sensors.values(), key=_Sensor.worth).name]
            sensor = self._sensors[sample.sensor] = _Sensor(sample.sensor, self._to_pad_m, self._turn)
            self.reports = True
            self._begun = min(self._begun, t)
        if (verdict := sensor.add(sample, t)) is not None:
            return verdict
        in_sight = bool(self._seen) and t - self._seen[-1][0] < _IN_SIGHT_S
        return sensor.now(sample, t, [kind for kind in self._used(sensor) if not in_sight or sensor.proven(kind)])

    def sighted(self, sighting: Sighting, carried_down_m: float) -> None:
        """Take what a fused sighting shows.

        Args:
            carried_down_m: the body's place by the IMU alone at the exposure, downward from anywhere.
        """
        t, whole = 1e-9 * sighting.stamp.measured_at, sighting.pose6
        if self._seen and t - self._seen[-1][0] < 0.9 / _SEEN_HZ:
            return
        if self._seen and t - self._seen[-1][0] > _GAP_S:
            self.begin_window()
        down, roll, pitch = sighting.d_body_pad_level.item(2) + carried_down_m, math.nan, math.nan
        if whole is not None:
            R = whole.R_level_pad.matrix
            down, roll = whole.d_body_pad_level.item(2) + carried_down_m, math.atan2(R[2, 1], R[2, 2])
            pitch = -math.asin(max(-1.0, min(1.0, R[2, 0])))
        self._seen.append((t, down, roll, pitch))
        settled = self._begun + _SETTLES_S
        while t - self._seen[0][0] > _WINDOW_S or self._seen[0][0] < settled < t:
            self._seen.pop(0)
        if t - self._judged >= _JUDGES_S and t > settled:
            since_s, self._judged = min(t - self._judged, _JUDGES_S), t
            for sensor in self._sensors.values():
                sensor.compare(np.array(self._seen), since_s)

    def feel(self, report: VesselMotion | VesselReport) -> None:
        """Find the begin of a manoeuvre in a horizontal acceleration or a rate of turn, as it arrives.

        From one moment to the next it changes by no more than usual, on waves as well; the begin is a change far beyond the
        largest of the last seconds. A sensor that leaps now and then makes that usual.
        """
        if isinstance(report, VesselMotion):
            name, value, least = report.sensor, report.acceleration_m_s2, _JOLT_M_S2
        else:
            name, value, least = "", report.turn_rad_s, _JOLT_RAD_S
        if value is None:
            return
        t = 1e-9 * report.stamp.received_at
        since, mean, usual, recent = self._felt.get(name, (t, value, 0.0, deque([(t, 0.0)])))
        step_s, off = t - recent[-1][0], abs(value - mean)
        if step_s > _GAP_S:
            since, mean, usual, off, recent = t, value, 0.0, 0.0, deque()
        # What has just begun is not usual yet.
        while recent and t - recent[0][0] > _JOLT_NEW_S:
            usual = max(usual, recent.popleft()[1])
        if t - since >= _JOLT_KNOWN_S and off > max(least, _JOLT * usual):
            self._jolted_s = t
        recent.append((t, off))
        mean += min(1.0, step_s / _JOLT_MEAN_S) * (value - mean)
        self._felt[name] = since, mean, usual * math.exp(-step_s / _JOLT_USUAL_S), recent

    def jolted(self, now: MonoNs) -> bool:
        """Return whether a manoeuvre has begun a moment before."""
        return 0.0 <= 1e-9 * now - self._jolted_s < _JOLTED_S

    def begin_window(self) -> None:
        """Begin the comparison again: the IMU's place has another origin."""
        self._seen = []

    def _used(self, sensor: _Sensor) -> tuple[Channel, ...]:
        """Return the channels of a sensor that are fused: of all that report one, the one that errs least."""
        return tuple(kind for kind in get_args(Channel) if self._best(kind) is sensor)

    def _best(self, kind: Channel) -> _Sensor | None:
        wanted = [s for s in self._sensors.values() if self._options.sensor in ("best", s.name) and not s.late]
        there = [s for s in wanted if s.channels[kind].t and not s.channels[kind].fault]
        newest = max((s.channels[kind].t[-1] for s in there), default=0.0)
        there = [s for s in there if newest - s.channels[kind].t[-1] < _SILENT_S]
        # The first one stays unless another is better by a fifth.
        noises = [s.channels[kind].noise * (0.8 if k == 0 else 1.0) for k, s in enumerate(there)]
        return there[noises.index(min(noises))] if there else None


def _flat(t: F64, bend: int) -> F64:
    """Return the rows, (n - bend - 1, n), of what a polynomial of that degree leaves of what was measured at instants, (n,)."""
    of, _ = np.linalg.qr(np.vander((t - t[0]) / (t[-1] - t[0]), bend + 1), mode="complete")
    made: F64 = of[:, bend + 1 :].T
    return made


def _whitening(kind: Channel, t: F64, bend: int, size: float) -> tuple[F64, float]:
    """Return what makes a good sensor's difference from the camera white, and the camera's part in each column's squares."""
    flat, apart_s, (white, alike, picture, leans) = _flat(t, bend), np.abs(t[:, None] - t), _ERRORS[kind]
    sensor = white**2 * np.eye(t.size) + (alike**2 + (_OF_SIZE * size) ** 2) * np.exp(-apart_s / _ALIKE_S)
    camera = picture**2 * np.eye(t.size) + leans**2 * np.exp(-apart_s / _LEANS_S)
    whiten = np.linalg.solve(np.linalg.cholesky(flat @ (sensor + camera) @ flat.T), flat)
    return whiten, float(np.sum(whiten * (whiten @ camera)))


def _squares(reported: F64, multiple: float, shown: F64) -> F64:
    """Return the squares, (d,), by which readings, (n, k), differ from a multiple of what was seen, (d, n, k), but for scale."""
    apart, scale = reported - multiple * shown, _SCALE * shown
    made: F64 = np.sum(apart**2, axis=(1, 2)) - np.sum(apart * scale, axis=(1, 2)) ** 2 / (1.0 + np.sum(scale**2, axis=(1, 2)))
    return made
