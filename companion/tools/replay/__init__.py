"""Run recorded inputs through the pilot again, on the recording's own clock."""
