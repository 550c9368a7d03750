"""The service as a MAVLink component: its identity, the messages that it sends, the commands that it takes."""
