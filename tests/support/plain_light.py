"""Light and a sensor without effects of their own, to measure geometry and one effect at a time."""

import math

from sitl.camera.light import Light, Sensor

FLAT = Light(vignetting=0.0, drone_shadow=0.0, wear=0.0)
"""Even light on perfect paint."""
IDEAL = Sensor(exposure_s=0.0, psf_sigma_px=0.0, full_well_e=math.inf, read_noise_e=0.0)
"""A sensor without blur and noise."""
