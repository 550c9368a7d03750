"""The content of a response file, as `response_from_mapping` reads it, with the source of its numbers."""

from __future__ import annotations

import msgspec

from companion.guidance.response import ClimbResponse, Response, TiltResponse
from companion.guidance.response_fit import ClimbFit, TiltFit

_PLACES = {"max_deg": 1, "frequency_rad_s": 3, "frequency_sigma_rad_s": 3}


def text(response: Response, source: str, tilt: TiltFit, climb: ClimbFit | None) -> str:
    """Return a response as TOML.

    Args:
        source: name of the recording that it was identified from.
        tilt, climb: the fits behind it; None where the given numbers were kept.
    """
    climbed = "as given: not identified" if climb is None else f"{climb.fitted.residual:.3f} m/s beside the model"
    return (
        f"# Identified from {' '.join(source.split())}: {tilt.fitted.seconds:.1f} s of leans, {tilt.fitted.residual:.3f} m/s^2 "
        f"beside the model,\n# {tilt.gain:.2f} of the asked tilt flown; climb {climbed}. The lag of the tilt and the limits are "
        f"as given.\n\n[tilt]\n{_table(response.tilt)}\n[climb]\n{_table(response.climb)}"
    )


def _table(of: TiltResponse | ClimbResponse) -> str:
    rows = {name: value for name, value in msgspec.structs.asdict(of).items() if value is not None}
    return "".join(f"{name} = {round(float(value), _PLACES.get(name, 4))!r}\n" for name, value in rows.items())
