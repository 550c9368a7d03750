"""Ready-made settings, cameras and pads, shipped with the package."""
