"""The service's cycle, which the daemon, the simulated flight and the replay drive."""
