"""Set seas, decks and the forecast beside measured ones.

Seas: spectra of buoys beside JONSWAP (gamma 3.3) and a fully grown sea (gamma 1) of the same height and period. `nu` is the
spectral width, `Qp` Goda's peakedness, `run` the mean number of waves in a row that are higher than the significant height
(Kimura 1980, from the spectrum).

Decks: standard deviation, period of the peak and width nu of heave, roll and pitch between 0.03 and 0.5 Hz, of recorded ships and
boats beside the simulated ones. Every third RTK boat is shown, smoothed by 0.5 s.

Forecasts: the filter is fed as in flight, hovering 5 m over the deck (30 sightings a second, late, 2 % of them wrong, mount and
delay unknown), for 0.5, 1 and 2 s ahead. Each cell has the rms error over the rms of what was forecast (1 is a forecast of the
mean), the rms error at 1 s, and the shares of truths inside the bands of 68 and 95 %. A recording has no surge, no sway and
nothing quicker than its samples, so it is kinder than its ship.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.signal import welch
from scipy.stats import rice

from benches.real import needed
from estimator import ekf
from estimator.contracts.geometry import F64
from sitl.scenario.scenario import load, sea_of, ship_model
from sitl.sea.sea import SeaState, Waves
from sitl.vessel.file import RecordedMotion
from sitl.vessel.seakeeping import Hull
from sitl.vessel.vessel import RecordedVessel, Vessel
from sitl.world.stage import sea_and_vessel
from tests.support.estimator_truth import OPTIONS, TruthFlight, events, ns, setting

TITLE = "Seas, decks and forecasts: buoys, a research vessel, boats"
HORIZONS_S = (0.5, 1.0, 2.0)
FLIGHT_S, SETTLED_S, EVERY_S, FLIGHTS = 60.0, 16.0, 0.5, 4
HOVER = ((0.0, 2.5, 1.5, 7.0), (5.0, 2.5, 1.5, 7.0), (12.0, 0.3, -0.2, 5.0), (60.0, 0.2, 0.2, 5.0))
SIMULATED = ("sea_state_4", "weather_3", "weather_4", "research_vessel", "patrol_boat", "ferry", "model_ship")
SHAKE_S, NOT_SENT, STILL = 0.5, 32767, 1e-4
LOW_HZ, HIGH_HZ, SEGMENT_S, STEP_S = 0.03, 0.5, 128.0, 0.2


class Spectrum(NamedTuple):
    """The shape of a spectrum over its frequencies, Hz."""

    hs: float
    tp: float
    tm02: float
    nu: float
    qp: float
    run: float

    @staticmethod
    def of(hz: F64, density: F64) -> "Spectrum":
        """Return the shape of a density, m^2/Hz."""
        m0, m1, m2 = (float(np.trapezoid(density * hz**k, hz)) for k in range(3))
        tm02 = math.sqrt(m0 / m2)
        together = abs(np.trapezoid(density * np.exp(2j * math.pi * hz * tm02), hz)) / m0
        r = np.linspace(2.0, 12.0, 4001)
        rayleigh, rest = r * np.exp(-0.5 * r**2), math.sqrt(1.0 - together**2)
        again = np.trapezoid(rayleigh * rice.sf(2.0 / rest, together * r / rest), r) / np.trapezoid(rayleigh, r)
        nu = math.sqrt(max(m0 * m2 / m1**2 - 1.0, 0.0))
        qp = 2.0 * float(np.trapezoid(hz * density**2, hz)) / m0**2
        return Spectrum(4.0 * math.sqrt(m0), 1.0 / float(hz[density.argmax()]), tm02, nu, qp, 1.0 / (1.0 - float(again)))

    def cells(self) -> str:
        return f"{self.tm02:.1f} s, {self.nu:.2f}, {self.qp:.2f}, {self.run:.2f}"


HZ = np.arange(0.03, 0.405, 0.01)
MEASURED = (
    ("NDBC 46042, Monterey, 1996: Hs 0.5 to 1.25 m", 771, Spectrum(1.11, 12.5, 6.89, 0.51, 1.61, 1.27)),
    ("the same, 1.25 to 2.5 m", 5191, Spectrum(1.84, 11.1, 6.79, 0.45, 1.74, 1.26)),
    ("the same, of a peak of 5 to 7.5 s", 398, Spectrum(1.72, 6.7, 5.56, 0.39, 1.77, 1.21)),
    ("the same, 2.5 to 4 m", 2373, Spectrum(2.98, 12.5, 7.57, 0.44, 1.88, 1.30)),
    ("the same, 4 to 6 m", 263, Spectrum(4.34, 14.3, 8.96, 0.45, 2.00, 1.32)),
    ("NDBC 41010, off Florida, June 2020", 149, Spectrum(1.14, 6.7, 5.24, 0.33, 2.24, 1.28)),
    ("Spotter, September 2021", 179, Spectrum(1.28, 10.2, 6.63, 0.49, 1.87, 1.29)),
    ("Datawell, 2024-09-09 01:15 and 01:44", 2, Spectrum(0.88, 6.2, 4.73, 0.38, 2.56, 1.37)),
    ("TRIAXYS, 2018-01-31", 1, Spectrum(3.43, 11.1, 6.92, 0.49, 1.47, 1.21)),
)
"""Medians of measured spectra with their number. Sources: NDBC (public domain), by examples/data/wave/46042w1996.txt.gz of
MHKiT-Software/MHKiT-Python (9fa9f9c9, BSD-3) and tests/sample_files of wavespectra/wavespectra (82c7cb9, MIT); the rest by the
latter."""
SPREAD = (
    "Circular deviation of directions at the peak, degrees: 41010 32, Spotter 21 and 27, Datawell 33 and 25; ours 24 (s = 10)."
)


def seas() -> Iterator[str]:
    yield "| sea | spectra | Hs, Tp | measured: Tm02, nu, Qp, run | JONSWAP, gamma 3.3 | gamma 1 |"
    yield "|" + "---|" * 6
    for name, n, m in MEASURED:
        ours = (Spectrum.of(HZ, SeaState(m.hs, m.tp, gamma).density(math.tau * HZ)) for gamma in (3.3, 1.0))
        yield f"| {name} | {n} | {m.hs:.2f} m, {m.tp:.1f} s | {m.cells()} | {' | '.join(s.cells() for s in ours)} |"
    for name in ("sea_state_3", "sea_state_4", "sea_state_5", "weather_3", "weather_4", "weather_5", "research_vessel"):
        density = sum(system.state.density(math.tau * HZ) for system in sea_of(load(name)).systems()) * math.tau
        s = Spectrum.of(HZ, np.asarray(density))
        yield f"| scenario `{name}` | | {s.hs:.2f} m, {s.tp:.1f} s | ours: {s.cells()} | | |"
    yield f"\n{SPREAD}\n"


class Deck(NamedTuple):
    """A deck whose motion is known: `vessel(k)` is what the k-th flight flies over."""

    name: str
    vessel: Callable[[int], Vessel]
    lasts_s: float = 600.0
    flights: int = FLIGHTS
    recorded: bool = True


def simulated(name: str) -> Deck:
    return Deck(f"ours: `{name}`", lambda k: sea_and_vessel(load(name), [k + 1])[1], flights=FLIGHTS, recorded=False)


def recorded(name: str, motion: RecordedMotion, scenario: str, flights: int = 2) -> Deck:
    """Return a recorded deck on the hull of a scenario's ship; its flights begin one after the other."""
    hull: Hull = ship_model(load(scenario)).hull
    flat = Waves.draw(SeaState(0.0, 5.0), 0)
    flights = max(1, min(flights, int(motion.lasts_s // FLIGHT_S)))
    apart_s = (motion.lasts_s - FLIGHT_S - 1.0) / max(1, flights - 1)
    return Deck(name, lambda k: RecordedVessel(hull, flat, motion, k % flights * apart_s), motion.lasts_s, flights)


def canboat(path: Path, source: int) -> RecordedMotion:
    """Return attitude (127257) and heave (127252) of one sensor in canboat's text; what it does not send is 0."""
    found: dict[str, list[tuple[float, ...]]] = {"127257": [], "127252": []}
    for cells in (line.split(",") for line in path.read_text().splitlines()[1:]):
        if cells[3] == str(source) and cells[2] in found:
            hours, minutes, seconds = cells[0].partition("T")[2].rstrip("Z").split(":")
            raw = np.frombuffer(bytes(int(x, 16) for x in cells[7:13]), "<i2")
            found[cells[2]].append((3600.0 * int(hours) + 60.0 * int(minutes) + float(seconds), *raw.tolist()))
    angles, heave = (np.array(rows).reshape(-1, 4) for rows in found.values())
    t = np.arange(0.0, angles[-1, 0] - angles[0, 0], 0.1)
    eta = np.zeros((t.size, 6))
    for column, value in ((3, angles[:, 3]), (4, angles[:, 2]), (5, angles[:, 1])):
        if abs(value[0]) < NOT_SENT:
            eta[:, column] = np.interp(t, angles[:, 0] - angles[0, 0], np.unwrap(1e-4 * value))
    if len(heave):
        # Its steps of a centimetre are no motion.
        up = np.interp(t, heave[:, 0] - angles[0, 0], 1e-2 * (heave[:, 1] - heave[:, 1].mean()))
        eta[:, 2] = -gaussian_filter1d(up, 2.0)
    return RecordedMotion.of(t, eta)


def decks() -> Iterator[Deck]:
    """Yield the recorded decks, then ours."""
    for name in ("s330", "seap"):
        log = needed("ship_palmer", f"{name}.txt")
        yield recorded(f"R/V Palmer, 94 m, {name}", RecordedMotion.of_file(log, 0.0), "research_vessel", FLIGHTS)
    for log in sorted(needed("boat_nmea2000").glob("*.raw")):
        for source, what in ((52, "no heave"), (27, "a heave that wanders, no yaw")):
            yield recorded(f"{log.stem}, sensor {source} ({what})", canboat(log, source), "patrol_boat")
    for log in sorted(needed("sea_motion").glob("2*.txt"))[::3]:
        yield recorded(f"RTK boat {log.stem}", RecordedMotion.of_file(log, SHAKE_S), "patrol_boat")
    yield from (simulated(name) for name in SIMULATED)


def motion_row(deck: Deck) -> str:
    """Return a deck's heave, roll and pitch: deviation, period of the peak, width."""
    t = np.arange(0.0, deck.lasts_s, STEP_S)
    runs = [deck.vessel(k).motion(t).eta[0] for k in range(1 if deck.recorded else deck.flights)]
    cells = []
    for column, scale, unit, digits in ((2, 100.0, "cm", 0), (3, math.degrees(1.0), "deg", 2), (4, math.degrees(1.0), "deg", 2)):
        n = min(round(SEGMENT_S / STEP_S), t.size)
        found = [welch(run[:, column], 1.0 / STEP_S, nperseg=n, detrend="linear") for run in runs]
        hz = found[0][0]
        band = (hz >= LOW_HZ) & (hz <= HIGH_HZ)
        density = np.mean([power for _, power in found], axis=0)[band]
        sd = float(np.mean([np.std(run[:, column]) for run in runs]))
        shape = Spectrum.of(hz[band], density) if sd > 1e-6 else None
        cells.append(f"{scale * sd:.{digits}f} {unit}, {shape.tp:.1f} s, {shape.nu:.2f}" if shape else "-")
    return f"| {deck.name} | {t[-1]:.0f} s x {len(runs)} | {' | '.join(cells)} |"


class OverDeck(TruthFlight):
    """A flight over a given vessel: the body goes where she goes, without her waves."""

    def __init__(self, deck: Deck, flight: int) -> None:
        drawn = replace(setting(flight), sea=0, sighting_hz=30.0, duration_s=FLIGHT_S, legs=HOVER, pose6=True)
        super().__init__(
            replace(drawn, sigma_lateral_per_m=0.0005, sigma_range_per_m=0.001, sigma_yaw_deg=0.2, sigma_tilt_deg=0.3)
        )
        self.vessel, self.u, self.p0 = deck.vessel(flight), np.zeros(3), np.zeros(3)
        t = np.arange(0.0, FLIGHT_S + 0.1, 0.1)
        pad = self.pad(t)[0]
        pad[:, :2] = gaussian_filter1d(pad[:, :2], 30.0, axis=0, mode="nearest")
        pad[:, 2] = pad[:, 2].mean()
        self._way = CubicSpline(t, pad)

    def body(self, t: F64) -> tuple[F64, F64, F64]:
        p, v, a = super().body(t)
        return p + self._way(t), v + self._way(t, 1), a + self._way(t, 2)

    def deck(self, t: F64) -> F64:
        """Return (n, 4): the pad's height and vertical speed, down, and the deck's roll and pitch."""
        p, v, R = self.pad(t)
        return np.stack([p[:, 2], v[:, 2], np.arctan2(R[:, 2, 1], R[:, 2, 2]), -np.arcsin(R[:, 2, 0])], axis=1)


def forecast_row(deck: Deck) -> str:
    """Return how well the filter forecasts a deck: its pad's place and speed, both vertical, and roll and pitch together."""
    horizons, flights = np.array(HORIZONS_S), []
    for k in range(deck.flights):
        flight, fed, next_s, rows = OverDeck(deck, k), ekf.Filter(OPTIONS), SETTLED_S, []
        for event in events(flight):
            if event.stamp.received_at >= ns(next_s) and next_s < FLIGHT_S - HORIZONS_S[-1]:
                ahead = fed.forecast(ns(next_s), HORIZONS_S)
                if ahead is not None:
                    p, v, _ = flight.body(np.array([next_s]))
                    down = p[0, 2] + v[0, 2] * horizons + ahead.d_body_pad_level[:, 2]
                    said = np.stack([down, -ahead.rise_m_s, ahead.roll_rad, ahead.pitch_rad], axis=1)
                    place = np.sqrt(ahead.cov_d_level[:, 2, 2])
                    sigma = np.stack([place, ahead.sigma_rise_m_s, ahead.sigma_roll_rad, ahead.sigma_pitch_rad], axis=1)
                    rows.append((flight.deck(next_s + horizons), said, sigma))
                next_s += EVERY_S
            fed.put([event])
        true, said, sigma = (np.array(x) for x in zip(*rows, strict=True))
        flights.append((true - true.mean(axis=0), said - true, sigma))
    moved, error, sigma = (np.concatenate(x) for x in zip(*flights, strict=True))
    cells = []
    for part, scale, unit in ((slice(0, 1), 100.0, "cm"), (slice(1, 2), 100.0, "cm/s"), (slice(2, 4), math.degrees(1.0), "deg")):
        off, rms = np.abs(error / sigma)[:, :, part], np.sqrt(np.mean(error[:, :, part] ** 2, axis=(0, 2)))
        size = np.sqrt(np.mean(moved[:, :, part] ** 2, axis=(0, 2)))
        ratio = " ".join(f"{x:.2f}" for x in rms / size) if size.min() > STILL else "-"
        inside = (100.0 * np.mean(off <= z, axis=(0, 2)) for z in (0.9945, 1.96))
        pairs = " ".join(f"{a:.0f}/{b:.0f}" for a, b in zip(*inside, strict=True))
        cells.append(f"{ratio}; {scale * rms[1]:.2g} {unit}; {pairs}")
    return f"| {deck.name} | {len(error)} | {' | '.join(cells)} |"


def table(every: int = 1) -> Iterator[str]:
    """Yield the lines of the three tables.

    Args:
        every: only every Nth deck.
    """
    yield from seas()
    found = list(decks())[::every]
    yield "| deck | length | heave: sd, Tp, nu | roll | pitch |"
    yield "|" + "---|" * 5
    yield from map(motion_row, found)
    yield "\n| deck | forecasts | place, vertical: 0.5, 1, 2 s; in the bands | vertical speed | roll, pitch |"
    yield "|" + "---|" * 5
    yield from map(forecast_row, found)
