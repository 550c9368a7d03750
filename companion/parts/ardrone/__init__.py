"""The AR.Drone as the service's vehicle."""
