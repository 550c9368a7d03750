"""The vehicle's sensors and their faults."""
