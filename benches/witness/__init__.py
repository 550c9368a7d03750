"""The simulator beside physics and seas of others."""
