"""The content of a response file, as `response_from_mapping` reads it, with the source of its numbers."""

from __future__ import annotations

import msgspec

from companion.guidance.response_fit import ClimbFit, TiltFit
from companion.settings.response import ClimbResponse, Response, TiltResponse
from estimator.contracts.geometry import F64

_PLACES = {"max_deg": 1, "frequency_rad_s": 3, "frequency_sigma_rad_s": 3}


def text(response: Response, source: str, tilt: TiltFit, climb: ClimbFit | None) -> str:
    """Return a response as TOML, with the covariance of what was identified.

    Args:
        source: name of the recording that it was identified from.
        tilt, climb: the fits behind it; None where the given numbers were kept.

    Raises:
        ValueError: a covariance is none, because the flight tells next to nothing.
    """
    climbed = "as given: not identified" if climb is None else f"{climb.fitted.residual:.3f} m/s beside the model"
    tilt_table = _identified(response.tilt, "cov_delay_frequency_damping", tilt.cov)
    climb_table = _table(response.climb) if climb is None else _identified(response.climb, "cov_delay_lag", climb.cov)
    return (
        f"# Identified from {' '.join(source.split())}: {tilt.fitted.seconds:.1f} s of leans, {tilt.fitted.residual:.3f} m/s^2 "
        f"beside the model,\n# {tilt.gain:.2f} of the asked tilt flown; climb {climbed}. The lag of the tilt and the limits are "
        f"as given.\n\n[tilt]\n{tilt_table}\n[climb]\n{climb_table}"
    )


def _identified(of: TiltResponse | ClimbResponse, key: str, cov: F64) -> str:
    """Return a table whose standard deviations stand in its covariance, and as comments for people."""
    rows = [[float(f"{0.5 * (a + b):.6g}") for a, b in zip(*pair, strict=True)] for pair in zip(cov, cov.T, strict=True)]
    none: dict[str, float | None] = {name: None for name in msgspec.structs.asdict(of) if "sigma" in name}
    known = msgspec.structs.replace(of, **{**none, key: tuple(tuple(row) for row in rows)})
    lines = []
    for name, value in _numbers(known).items():
        sigma = getattr(known, _SIGMAS.get(name, ""), None)
        if "sigma" not in name:
            lines.append(f"{name} = {value!r}" + ("" if sigma is None else f"  # +- {sigma:.2g}"))
    matrix = "".join(f"    {row!r},\n" for row in rows)
    return "\n".join(lines) + f"\n{key} = [\n{matrix}]\n"


_SIGMAS = {
    "delay_s": "delay_sigma_s", "frequency_rad_s": "frequency_sigma_rad_s", "damping": "damping_sigma", "lag_s": "lag_sigma_s",
}  # fmt: skip


def _table(of: ClimbResponse) -> str:
    lines = [f"{name} = {value!r}\n" for name, value in _numbers(of).items()]
    if of.cov_delay_lag is not None:
        lines = [line for line in lines if "sigma" not in line]
        lines.append(f"cov_delay_lag = {[list(row) for row in of.cov_delay_lag]!r}\n")
    return "".join(lines)


def _numbers(of: TiltResponse | ClimbResponse) -> dict[str, float]:
    given = {name: value for name, value in msgspec.structs.asdict(of).items() if isinstance(value, float | int)}
    return {name: round(float(value), _PLACES.get(name, 4)) for name, value in given.items()}
