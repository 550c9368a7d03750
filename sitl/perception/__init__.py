"""How a simulated flight perceives the pad: rendered frames, an error model of detections, or the truth with an error model."""
