"""Record the service's inputs, decisions and outputs during the flight."""
