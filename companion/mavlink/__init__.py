"""The service as a MAVLink component: who it is, what it says, what it can be told."""
