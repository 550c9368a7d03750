"""Pressure and height in the troposphere of the international standard atmosphere (ISO 2533)."""


def height_of_pressure_m(pressure_pa: float) -> float:
    """Return the pressure altitude in metres."""
    return float(44330.77 * (1.0 - (pressure_pa / 101325.0) ** 0.190263))


def pressure_of_height_pa(height_m: float) -> float:
    """Return the pressure at a pressure altitude, Pa: the inverse of `height_of_pressure_m`."""
    return float(101325.0 * (1.0 - height_m / 44330.77) ** (1.0 / 0.190263))
