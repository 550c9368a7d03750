"""Input checks before every estimator path: whether an input is fresh, possible, and about the pad that is being tracked.

    guard, verdict = admit(guard, sample)               # None: let it through
    guard, verdict = admit_frame(guard, frame)
    guard, verdict = admit_sighting(guard, sighting, attitude, belief)
    doubts(guard, now)                                  # what speaks against descending by the estimate

Pure: values in, values out. Freshness is of the world and not of the packet: a frame or reading with a new stamp that shows
nothing new is refused, so that the estimate ages.
"""

from estimator.integrity.guard import IntegrityGuard, admit, admit_frame, admit_sighting, doubts, fused
from estimator.integrity.options import IntegrityOptions

__all__ = ["IntegrityGuard", "IntegrityOptions", "admit", "admit_frame", "admit_sighting", "doubts", "fused"]
