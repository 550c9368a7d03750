"""Where the filter expects the pad in a frame: with the errors of attitude and camera mount that it knows."""

from __future__ import annotations

from companion.runtime.observer import ProcessedFrame
from estimator.contracts.estimates import PathName
from estimator.contracts.geometry import F64


def expected_in_body(processed: ProcessedFrame, path: PathName | None) -> F64 | None:
    """Return where the path's estimate expected the pad's centre in the frame, (3,) m in `body`, with the camera file's mount.

    It is what vision saw less the innovation. Drawn from the reported attitude and the nominal mount, an estimate lies beside the
    pad in the picture by the errors of both.

    Returns:
        None for a frame that was not compared with the path's estimate.
    """
    seen = None if processed.detection is None else processed.detection.selected
    if seen is None or processed.attitude is None:
        return None
    compared = next((one for one in processed.results if one.path == path and one.innovation is not None), None)
    if compared is None or compared.innovation is None:
        return None
    in_body: F64 = processed.attitude.R_ned_body.without_heading().inv @ seen.d_body_pad_level - compared.innovation[:3]
    return in_body
