"""The picture for ground stations: H.264 by RTP, with the estimate drawn over it."""
