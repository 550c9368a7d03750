"""Telemetry, events and commands over MQTT. docs/mqtt.md describes the topics and messages.

These modules do no I/O: `topics`, `messages`, `encode`, `commands`, `events`. These do: `spool` (disk), `connection` and `part`
(sockets).
"""
