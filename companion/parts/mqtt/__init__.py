"""Telemetry, events and commands over MQTT. docs/mqtt.md describes the topics and messages.

These modules do no I/O: `messages`, `encode`, `commands`, `watch`. These do: `spool` (disk), `connection` and `part` (sockets).
"""
