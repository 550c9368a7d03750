"""Real autopilot programs: what starts them, and the physics that they step."""
