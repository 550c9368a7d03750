"""A processed frame made by hand, with a pad in it or without."""

from types import MappingProxyType

import numpy as np

from companion.base.observer import ProcessedFrame
from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.detection import Detection, PadCheck, PadThing


def seen(at: MonoNs, found: bool) -> ProcessedFrame:
    """Return a frame exposed 30 ms before it was received at `at`, in which the pad was found or not."""
    stamp = Stamp(MonoNs(at - 30_000_000), at, 0.001, "sim")
    frame = Frame(stamp, 7, np.zeros((4, 6, 3), np.uint8))
    cov = np.diag([0.1, 0.2, 0.3, 0.4])
    one = Sighting(stamp, 7, "selected", np.array([1.0, 2.0, 3.0]), 0.5, True, cov, 0.9) if found else None
    check = PadCheck(at, 1.0, PadThing(0.25, 0.1, -0.15)) if found else None
    look = Detection(one, "ellipse" if found else None, MappingProxyType({"ellipse": one, "arrow": None}), on_pad=check)
    return ProcessedFrame(frame, None, look, Verdict.FUSED if found else Verdict.NO_PAD, at, MonoNs(at + 5_000_000))
