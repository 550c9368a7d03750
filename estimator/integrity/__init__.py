"""Input checks before every estimator path: whether an input is fresh, possible, and about the tracked pad.

    guard, verdict = admit(guard, sample)               # None: the sample may pass
    guard, attitude = steadied(guard, attitude)         # its heading, where the gyro contradicts it
    guard, verdict = admit_frame(guard, frame)
    guard, verdict = admit_sighting(guard, sighting, attitude, belief)
    alerts(guard, now)                                  # reasons not to descend by the estimate

The functions are pure. Freshness concerns the content and not the packet: a frame or reading with a new stamp but the same
content is refused, so that the estimate ages.
"""

from estimator.integrity.guard import IntegrityGuard, admit, admit_frame, admit_sighting, alerts, fused, steadied
from estimator.integrity.options import IntegrityOptions

__all__ = ["IntegrityGuard", "IntegrityOptions", "admit", "admit_frame", "admit_sighting", "alerts", "fused", "steadied"]
