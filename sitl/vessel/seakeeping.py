"""The response of a hull to waves: closed-form complex responses in six degrees of freedom.

Heave and pitch: Jensen, Mansour & Olsen, Estimation of ship motions using closed-form expressions, Ocean Engineering 31
(2004) 61-85, sections 2.1-2.2, for a box-shaped hull. Roll: wave slope through one damped oscillator. Surge, sway and yaw:
the hull is carried by the orbital motion of the water, averaged over its length and beam.
Written for long-crested deep-water waves; amplitudes within about a quarter of published tables of real hulls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from sitl.sea.spectra import GRAVITY_M_S2
from sitl.vessel.response_table import ResponseTable


@dataclass(frozen=True, slots=True)
class Superstructure:
    """A block on deck that the wind flows around."""

    forward_m: float
    """Distance of its centre forward of amidships, m."""
    starboard_m: float
    length_m: float
    width_m: float
    height_m: float
    """Height over the deck of the pad, m."""


@dataclass(frozen=True, slots=True)
class Hull:
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


def hull(name: str) -> Hull:
    """Return the preset of that name.

    Raises:
        BadInput: no such hull.
    """
    if name not in HULLS:
        raise BadInput(f"hull must be one of {', '.join(HULLS)}, got {name!r}")
    return HULLS[name]


def encounter_rad_s(w_rad_s: F64, beta_rad: F64, speed_m_s: float) -> F64:
    """Return the frequency at which a hull under way meets a wave; it is negative for a wave that the hull overtakes.

    `beta_rad` is as in `responses`.
    """
    w = np.asarray(w_rad_s, dtype=float)
    return np.asarray(w - w**2 / GRAVITY_M_S2 * speed_m_s * np.cos(beta_rad))


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
    k = w**2 / GRAVITY_M_S2
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
