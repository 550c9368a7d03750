"""The fields of navdata that the service reads of every datagram, as plain numbers, unpacked at once.

A datagram has 28 options, 200 times a second. The service reads some twenty fields of six of them; making an object of each of
these takes longer than the rest of decoding.
"""

import struct
from collections.abc import Callable, Mapping
from typing import Any

from msgspec import Struct

from drivers.ardrone.navdata_options import (
    TAG_OF_CLASS,
    Altitude,
    Demo,
    Gps,
    OptionLayout,
    PhysMeasures,
    PressureRaw,
    RawMeasures,
)


class NavdataReadings(Struct, frozen=True):
    """The fields, named as in their options; those of an option that a datagram does not hold are None."""

    ctrl_state: int | None
    battery_percent: int | None
    theta_mdeg: float | None
    phi_mdeg: float | None
    psi_mdeg: float | None
    altitude_mm: int | None
    vx_mm_s: float | None
    vy_mm_s: float | None
    nb_echo: int | None
    sum_echo: int | None
    ax_mg: float | None
    ay_mg: float | None
    az_mg: float | None
    wx_deg_s: float | None
    wy_deg_s: float | None
    wz_deg_s: float | None
    altitude_raw_mm: int | None
    up: int | None
    ut: int | None
    temperature_dc: int | None
    pressure_pa: int | None
    gps_plugged: int | None


_READ: tuple[tuple[type[Any], tuple[str, ...]], ...] = (
    (Demo, ("ctrl_state", "battery_percent", "theta_mdeg", "phi_mdeg", "psi_mdeg", "altitude_mm", "vx_mm_s", "vy_mm_s")),
    (RawMeasures, ("nb_echo", "sum_echo")),
    (PhysMeasures, ("phys_accs_mg", "phys_gyros_deg_s")),
    (Altitude, ("altitude_raw_mm",)),
    (PressureRaw, ("up", "ut", "temperature_dc", "pressure_pa")),
    (Gps, ("gps_plugged",)),
)
"""The options with the fields that are read, in the order of `NavdataReadings`, which is that of the wire."""

_DEMO, _RAW, _MEASURES, _ALTITUDE, _PRESSURE, _GPS = (
    TAG_OF_CLASS[cls] for cls in (Demo, RawMeasures, PhysMeasures, Altitude, PressureRaw, Gps)
)
_NONE = (None, None, None)
_NO_DEMO: Any = NavdataReadings(*[None] * 22)
_NO_RAW = _NO_PRESSURE = _NO_DEMO
"""Placeholders for options that a datagram does not hold."""


def readings_of(options: Mapping[int, Any]) -> NavdataReadings:
    """Return the fields of options that were made one by one, as the simulator makes them."""
    get = options.get
    demo, raw, measures, altitude = get(_DEMO), get(_RAW), get(_MEASURES), get(_ALTITUDE)
    pressure, gps = get(_PRESSURE), get(_GPS)
    ax, ay, az = measures.phys_accs_mg if type(measures) is PhysMeasures else _NONE
    wx, wy, wz = measures.phys_gyros_deg_s if type(measures) is PhysMeasures else _NONE
    if type(demo) is not Demo:
        demo = _NO_DEMO
    if type(raw) is not RawMeasures:
        raw = _NO_RAW
    if type(pressure) is not PressureRaw:
        pressure = _NO_PRESSURE
    return NavdataReadings(
        demo.ctrl_state, demo.battery_percent, demo.theta_mdeg, demo.phi_mdeg, demo.psi_mdeg, demo.altitude_mm, demo.vx_mm_s,
        demo.vy_mm_s, raw.nb_echo, raw.sum_echo, ax, ay, az, wx, wy, wz,
        altitude.altitude_raw_mm if type(altitude) is Altitude else None,
        pressure.up, pressure.ut, pressure.temperature_dc, pressure.pressure_pa, gps.gps_plugged if type(gps) is Gps else None,
    )  # fmt: skip


def reader(bodies: Mapping[int, tuple[OptionLayout, int]]) -> Callable[[bytes], NavdataReadings]:
    """Return what reads the fields of every datagram whose options lie where this one's do.

    Args:
        bodies: the layout of each option by tag, and the place of its body in the datagram.
    """
    places: list[tuple[int, str, int]] = []
    """Offset of a field, its letters, and the place of its numbers in `NavdataReadings`."""
    size = 0
    for cls, names in _READ:
        layout, body = bodies.get(TAG_OF_CLASS[cls], (None, 0))
        for name in names:
            numbers = 3 if cls is PhysMeasures else 1
            if layout is not None and layout.cls is cls:
                at, letters = layout.field(name)
                places.append((body + at, letters, size))
            size += numbers
    places.sort()
    form, end, order = "<", 0, [-1] * size
    """Format to unpack, and for each number of the result its index in the unpacked tuple.

    The last index is None for an absent number.
    """
    n = 0
    for at, letters, first in places:
        form += f"{at - end}x{letters}"
        end = at + struct.calcsize(f"<{letters}")
        for i in range(3 if letters[:-1] else 1):
            order[first + i] = n
            n += 1
    unpack = struct.Struct(form).unpack_from
    if order == list(range(size)):
        return lambda datagram: NavdataReadings(*unpack(datagram))

    def read(datagram: bytes) -> NavdataReadings:
        found = (*unpack(datagram), None)
        return NavdataReadings(*[found[i] for i in order])

    return read
