"""Input checks before every estimator path: whether an input is fresh, possible, and about the tracked pad.

    guard, admitted = admit(guard, samples)             # for each what may pass, or a verdict
    guard, verdict = admit_frame(guard, frame)          # None: the frame may pass
    guard, verdict = admit_sighting(guard, sighting, attitude, belief)
    guard = follow(guard, sighting, assumed)            # of a frame that no attitude covers
    excludes(belief, sighting, options)                 # whether the tracked pad cannot be in that place
    alerts(guard, now)                                  # reasons not to descend by the estimate

The functions are pure. Freshness concerns the content and not the packet: a frame or reading with a new stamp but the same
content is refused, so that the estimate ages.
"""
