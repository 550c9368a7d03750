"""The pad as data: its file, shapes, rules, drawing and what can be measured of it."""
