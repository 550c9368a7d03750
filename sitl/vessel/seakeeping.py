"""The response of a hull to waves: closed-form complex responses in six degrees of freedom.

Heave and pitch: Jensen, Mansour & Olsen, Estimation of ship motions using closed-form expressions, Ocean Engineering 31
(2004) 61-85, sections 2.1-2.2, for a box-shaped hull. Roll: wave slope through one damped oscillator. Surge, sway and yaw:
the hull is carried by the orbital motion of the water, averaged over its length and beam.
Written for long-crested deep-water waves; amplitudes within about a quarter of published tables of real hulls.

A hull may answer by a table instead: amplitude and phase per encounter frequency and heading. In a turn a ship loses speed and
heels outwards.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.contracts.keys import number
from estimator.contracts.motion import G_M_S2

MODES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_ODD = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
"""A wave from the other side mirrors sway, roll and yaw of a hull that is alike on both sides."""
_NODES = 1001
"""Points of the path through the beginning of the turn; the path between them is exact to a micrometre."""


class ResponseTable(Struct, frozen=True, eq=False):
    """Complex responses on a grid, as `sitl.vessel.seakeeping.responses` returns them."""

    encounter_rad_s: F64
    """(F,) ascending, positive."""
    heading_rad: F64
    """(D,) ascending from 0 (following sea) to pi (head sea); waves from port, those from starboard are their mirror."""
    grid: NDArray[np.complex128]
    """(6, D, F)."""

    @staticmethod
    def of(
        encounter_rad_s: list[float], heading_deg: list[float], modes: Mapping[str, tuple[list[list[float]], list[list[float]]]]
    ) -> ResponseTable:
        """Return the table of (amplitudes, phases in degrees) by mode, each with one row a heading; a missing mode is zero.

        Amplitudes are m/m for surge (forward), sway (to starboard) and heave (up), degrees/m for roll (starboard down), pitch
        (bow up) and yaw (to starboard). The phase is the motion's lead over the crest amidships.

        Raises:
            ValueError: axes that do not ascend or span 0 to 180 degrees, rows that do not match them, a negative amplitude.
        """
        w, heading = np.asarray(encounter_rad_s, dtype=float), np.asarray(heading_deg, dtype=float)
        if w.size < 2 or np.any(np.diff(w) <= 0) or w[0] <= 0:
            raise ValueError("encounter_rad_s must hold two or more ascending frequencies over 0")
        if heading.size < 2 or np.any(np.diff(heading) <= 0) or heading[0] != 0.0 or heading[-1] != 180.0:
            raise ValueError("heading_deg must ascend from 0 (following sea) to 180 (head sea)")
        grid = np.zeros((6, heading.size, w.size), dtype=complex)
        for i, mode in enumerate(MODES):
            if mode not in modes:
                continue
            for rows, what in zip(modes[mode], ("amplitude", "phase_deg"), strict=True):
                if len(rows) != heading.size or any(len(row) != w.size for row in rows):
                    raise ValueError(f"{mode}.{what} must hold {heading.size} rows (headings) of {w.size} numbers (frequencies)")
            amplitude, lead = (np.asarray(rows, dtype=float) for rows in modes[mode])
            if np.any(amplitude < 0):
                raise ValueError(f"{mode}.amplitude must be 0 or more: a negative one is a phase of 180 degrees")
            unit = (1.0, 1.0, -1.0, *(math.radians(1.0),) * 3)[i]  # heave is down inside
            # A wave is exp(i theta) with theta falling in time, so that a lead is a negative angle.
            grid[i] = unit * amplitude * np.exp(-1j * np.radians(lead))
        return ResponseTable(w, np.radians(heading), grid)

    def responses(self, encounter_rad_s: F64, beta_rad: F64) -> NDArray[np.complex128]:
        """Return (6, ...) responses for encounter frequencies and directions (...), bilinear between the table's points.

        Below the lowest frequency the lowest counts; above the highest the response falls with the fourth power of frequency.
        An overtaken wave (negative encounter frequency) runs backwards in time: its response is the conjugate.
        """
        we, beta = np.broadcast_arrays(np.asarray(encounter_rad_s, dtype=float), np.asarray(beta_rad, dtype=float))
        turned = (beta + math.pi) % math.tau - math.pi
        w = np.abs(we)
        i, x = _place(self.encounter_rad_s, np.clip(w, self.encounter_rad_s[0], self.encounter_rad_s[-1]))
        j, y = _place(self.heading_rad, np.clip(np.abs(turned), 0.0, math.pi))
        g = self.grid
        low = g[:, j, i] * (1.0 - x) + g[:, j, i + 1] * x
        high = g[:, j + 1, i] * (1.0 - x) + g[:, j + 1, i + 1] * x
        out = (low * (1.0 - y) + high * y) * (self.encounter_rad_s[-1] / np.maximum(w, self.encounter_rad_s[-1])) ** 4
        mirror = np.where(turned < 0, _ODD.reshape(6, *(1,) * w.ndim), 1.0)
        return np.asarray(mirror * np.where(we < 0, out.conj(), out))


def _place(axis: F64, value: F64) -> tuple[NDArray[np.intp], F64]:
    """Return the interval of each value on an ascending axis, and the share of the way through it."""
    i = np.clip(np.searchsorted(axis, value, side="right") - 1, 0, axis.size - 2)
    return i, (value - axis[i]) / (axis[i + 1] - axis[i])


class Superstructure(Struct, frozen=True, forbid_unknown_fields=True):
    """A block on deck that the wind flows around; frames do not show it."""

    forward_m: Annotated[float, number("distance of its centre forward of amidships", "m", -250.0, 250.0)]
    length_m: Annotated[float, number("length along the ship", "m", 0.2, 300.0)]
    width_m: Annotated[float, number("width across the ship", "m", 0.2, 80.0)]
    height_m: Annotated[float, number("height over the deck of the pad", "m", 0.2, 60.0)]
    starboard_m: Annotated[float, number("distance of its centre to starboard of the middle line", "m", -40.0, 40.0)] = 0.0

    def covers(self, forward_m: float, starboard_m: float) -> bool:
        """Return whether a place on deck lies under it."""
        along, across = abs(forward_m - self.forward_m), abs(starboard_m - self.starboard_m)
        return along < 0.5 * self.length_m and across < 0.5 * self.width_m


class Hull(Struct, frozen=True):
    """The figures that the responses need, and the position of the pad on the hull."""

    name: str
    length_m: float
    beam_m: float
    draught_m: float
    block: float
    """Block coefficient: displaced volume over length x beam x draught."""
    roll_period_s: float
    roll_damping: float
    """Roll damping over critical damping, waves and bilge together."""
    freeboard_m: float
    """Height of the deck over calm water."""
    bow_taper_m: float
    """Length over which the deck narrows to the stem; 0 for a barge."""
    d_vessel_pad_m: tuple[float, float]
    """Position of the pad's centre forward and to starboard of amidships; the pad lies on deck."""
    deck_beam_m: float | None = None
    """Width of the deck if it differs from the beam, m."""
    gm_m: float | None = None
    """Transverse metacentric height; a ship that turns needs it."""
    kg_m: float | None = None
    """Height of the centre of gravity over the keel; a ship that turns needs it."""
    table: ResponseTable | None = None
    """The responses, in place of the closed forms."""
    superstructure: Superstructure | None = None

    @property
    def deck_m(self) -> tuple[float, float]:
        """Length and width of the deck."""
        return self.length_m, self.beam_m if self.deck_beam_m is None else self.deck_beam_m


OTTER = Hull("otter", 2.0, 1.08, 0.195, 0.19, 0.76, 0.45, 0.45, 0.0, (0.0, 0.0))
"""Maritime Robotics Otter, a 2 m twin-hull USV: two pontoons 0.25 m wide (block coefficient over the full beam: 2 x 0.25 x
0.4 / 1.08). Roll period from 80 kg, gyradius 0.4 B, 20 % added inertia and the pontoons' water-plane at +-0.395 m, all as in
Fossen's PythonVehicleSimulator (otter.py); damping assumed."""

FERRY = Hull("ferry", 5.0, 2.8, 0.30, 0.60, 2.2, 0.25, 0.55, 0.0, (-0.6, 0.0))
"""A harbour ferry of milliAmpere's size (NTNU, 5 x 2.8 m); draught, block, roll period and damping assumed for the size."""

SUPPLY_SHIP = Hull("supply_ship", 82.8, 19.2, 6.0, 0.65, 10.0, 0.33, 3.0, 14.0, (-22.0, 0.0))
"""The supply vessel of Fossen's MSS toolbox: Lpp, beam, draught as there (GM_T 2.14 m); roll period and damping chosen so that
beam seas roll it 3.1 degrees a metre near 9.5 s, as its published response table does. The pad stands aft on the cargo deck."""

HULLS = {hull.name: hull for hull in (OTTER, FERRY, SUPPLY_SHIP)}


def encounter_rad_s(w_rad_s: F64, beta_rad: F64, speed_m_s: float) -> F64:
    """Return the frequency at which a hull under way meets a wave; it is negative for a wave that the hull overtakes.

    `beta_rad` is as in `responses`.
    """
    w = np.asarray(w_rad_s, dtype=float)
    return np.asarray(w - w**2 / G_M_S2 * speed_m_s * np.cos(beta_rad))


def responses(
    hull: Hull, w_rad_s: F64, beta_rad: F64, speed_m_s: float = 0.0, encounter: F64 | None = None
) -> NDArray[np.complex128]:
    """Return the motions of amidships per metre of wave amplitude.

    A wave a exp(i theta), theta falling with time, gives the motion Re(a H exp(i theta)).

    Args:
        w_rad_s: (...) wave frequency, positive.
        beta_rad: (...) direction the wave runs to, less the hull's heading: 0 following, pi/2 from port, pi head.
        encounter: (...) rad/s, where it does not follow from speed and direction, as at anchor in a current.

    Returns:
        (6, ...): surge forward, sway to starboard, heave down (m/m); roll starboard down, pitch bow up, yaw to starboard (rad/m).
    """
    w = np.asarray(w_rad_s, dtype=float)
    beta = np.asarray(beta_rad, dtype=float)
    k = w**2 / G_M_S2
    kx, ky = k * np.cos(beta), k * np.sin(beta)
    we = encounter_rad_s(w, beta, speed_m_s) if encounter is None else encounter
    if hull.table is not None:
        return hull.table.responses(we, beta)
    alpha = np.maximum(np.abs(we / w), 0.05)
    beam = hull.beam_m * hull.block

    smith = np.exp(-np.abs(kx) * hull.draught_m)
    sectional = 2.0 * np.sin(np.minimum(0.5 * k * beam * alpha**2, math.pi / 2)) * np.exp(-k * hull.draught_m * alpha**2)
    damping = sectional**2 / (k * beam * alpha**2)
    oscillator = 1.0 / (1.0 - 2.0 * k * hull.draught_m * alpha**2 - 1j * np.sign(we) * damping)
    force = np.sqrt((1.0 - k * hull.draught_m) ** 2 + (sectional**2 / (k * beam * alpha**3)) ** 2)
    along, across = _mean_of_cos(kx * hull.length_m / 2), _mean_of_cos(ky * hull.beam_m / 2)
    heave_up = oscillator * smith * force * along * across
    pitch = oscillator * smith * force * 1j * kx * _mean_slope(kx * hull.length_m / 2) * across

    wn = math.tau / hull.roll_period_s
    r = we / wn
    roll = -1j * ky * np.exp(-k * hull.draught_m / 2) * _mean_slope(ky * hull.beam_m / 2) * along
    roll = roll / (1.0 - r**2 - 2j * hull.roll_damping * r)

    carried = 1j * np.exp(-k * hull.draught_m / 2) * across
    surge, sway = carried * along * np.cos(beta), carried * along * np.sin(beta)
    yaw = carried * _mean_slope(kx * hull.length_m / 2) * 1j * kx * np.sin(beta)
    return np.stack([surge, sway, -heave_up, roll, pitch, yaw])


def _mean_of_cos(x: F64) -> F64:
    """sin(x) / x: a wave averaged over a length of 2x radians."""
    return np.sinc(x / math.pi)


def _mean_slope(x: F64) -> F64:
    """3 (sin x - x cos x) / x^3: the slope of the best straight line through sin over +-x, 1 for long waves."""
    small = np.abs(x) < 1e-2
    y = np.where(small, 1.0, x)
    return np.asarray(np.where(small, 1.0 - x**2 / 10.0, 3.0 * (np.sin(y) - y * np.cos(y)) / y**3))


def speed_in_turn_m_s(speed_m_s: float, rate_rad_s: float, length_m: float) -> float:
    """Return the steady speed in a turn that was begun at `speed_m_s`.

    Source: Lyster & Knights, Prediction equations for ships' turning circles, Trans. NECIES 95 (1979): the speed in the turn over
    that before it is 0.074 of the turning diameter in lengths, plus 0.149. The diameter is twice the new speed over the rate.
    """
    diameter_per_speed = 2.0 / (abs(rate_rad_s) * length_m)
    share = 0.074 * speed_m_s * diameter_per_speed
    return speed_m_s if share >= 1.0 - 0.149 else 0.149 * speed_m_s / (1.0 - share)


def heel_rad(hull: Hull, speed_m_s: F64, rate_rad_s: F64) -> F64:
    """Return the steady roll in a turn, starboard down positive: a turn to starboard heels the ship to port.

    Source: Rawson & Tupper, Basic Ship Theory, chapter on manoeuvrability, angle of heel when turning. The centripetal force acts
    at half the draught, the ship's inertia at its centre of gravity.
    """
    assert hull.gm_m is not None
    assert hull.kg_m is not None
    return np.asarray(-speed_m_s * rate_rad_s * (hull.kg_m - 0.5 * hull.draught_m) / (G_M_S2 * hull.gm_m))


class Turn(Struct, frozen=True):
    """A turn that begins at some instant: rate and speed go over smoothly, then the ship runs in a circle."""

    rate_rad_s: float
    """Clockwise from above positive, not 0."""
    at_s: float
    over_s: float
    """Time until rate and speed are steady."""


class Course(Struct, frozen=True, eq=False):
    """Course of the ship without waves at times (T,), relative to its place and heading at time 0."""

    p: F64
    """(T, 2) m ahead and to starboard of the first place, along the first heading."""
    v: F64
    a: F64
    yaw: F64
    """(T,) rad from the first heading."""
    rate: F64
    rate_dot: F64
    share: F64
    """(T, 3): how far the turn has developed, 0 to 1, with its two derivatives."""
    speed: F64
    """(T,) m/s."""


class TurningCourse:
    """The course of a ship that turns; `at` is exact except for the path while the turn develops."""

    def __init__(self, turn: Turn, speed_m_s: float, length_m: float) -> None:
        self.turn, self.before_m_s = turn, speed_m_s
        self.after_m_s = speed_in_turn_m_s(speed_m_s, turn.rate_rad_s, length_m)
        self._t = np.linspace(0.0, turn.over_s, _NODES)
        h = self._t[1]
        v = self._velocity(self._t)
        middle = self._velocity(self._t[:-1] + 0.5 * h)
        steps = h / 6.0 * (v[:-1] + 4.0 * middle + v[1:])
        self._p = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        self._v = v

    def at(self, t_s: F64) -> Course:
        """Return the course at times (T,)."""
        turn = self.turn
        x = t_s - turn.at_s
        s, s1, s2 = smooth_step(x / turn.over_s)
        share = np.stack([s, s1 / turn.over_s, s2 / turn.over_s**2], axis=-1)
        yaw, gained = self._yaw(x), self.after_m_s - self.before_m_s
        speed = self.before_m_s + gained * share[:, 0]
        rate, rate_dot = turn.rate_rad_s * share[:, 0], turn.rate_rad_s * share[:, 1]
        ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        across = np.stack([-np.sin(yaw), np.cos(yaw)], axis=-1)
        v = speed[:, None] * ahead
        a = (gained * share[:, 1])[:, None] * ahead + (speed * rate)[:, None] * across
        p = self._path(x) + np.array([self.before_m_s * turn.at_s, 0.0])
        return Course(p, v, a, yaw, rate, rate_dot, share, speed)

    def _path(self, x: F64) -> F64:
        """(T, 2) m from where the turn begins, x s after that."""
        turn, straight = self.turn, np.stack([self.before_m_s * x, np.zeros_like(x)], axis=-1)
        h = self._t[1]
        i = np.clip((x / h).astype(int), 0, _NODES - 2)
        u = np.clip((x - self._t[i]) / h, 0.0, 1.0)[:, None]
        p0, p1, v0, v1 = self._p[i], self._p[i + 1], self._v[i], self._v[i + 1]
        within = (1 + 2 * u) * (1 - u) ** 2 * p0 + u * (1 - u) ** 2 * h * v0 + u**2 * (3 - 2 * u) * p1 + u**2 * (u - 1) * h * v1
        late = np.maximum(x - turn.over_s, 0.0)
        yaw0 = 0.5 * turn.rate_rad_s * turn.over_s
        yaw, radius = yaw0 + turn.rate_rad_s * late, self.after_m_s / turn.rate_rad_s
        circle = np.stack([np.sin(yaw) - math.sin(yaw0), math.cos(yaw0) - np.cos(yaw)], axis=-1) * radius
        return np.where((x < 0)[:, None], straight, within + circle)

    def _velocity(self, x: F64) -> F64:
        yaw = self._yaw(x)
        speed = self.before_m_s + (self.after_m_s - self.before_m_s) * smooth_step(x / self.turn.over_s)[0]
        return np.stack([speed * np.cos(yaw), speed * np.sin(yaw)], axis=-1)

    def _yaw(self, x: F64) -> F64:
        u = np.clip(x / self.turn.over_s, 0.0, 1.0)
        developing = u**4 * (2.5 + u * (u - 3.0))
        return self.turn.rate_rad_s * (self.turn.over_s * developing + np.maximum(x - self.turn.over_s, 0.0))


def smooth_step(x: F64) -> tuple[F64, F64, F64]:
    """Return the fifth-order step from 0 to 1 and its two derivatives, which are 0 at both ends."""
    u = np.clip(x, 0.0, 1.0)
    return (u**3 * (10.0 + u * (6.0 * u - 15.0)), 30.0 * u**2 * (1.0 - u) ** 2, 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u))
