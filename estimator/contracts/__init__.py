"""The types that packages exchange: samples, estimates, geometry, time, errors, ports.

Standard library and numpy only. Conventions (frames, units, names): docs/conventions.md.
"""
