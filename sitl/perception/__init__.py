"""Perception of the pad in a simulated flight: rendered frames, a model of detections, or the truth with an error model."""
