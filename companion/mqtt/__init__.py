"""Telemetry, events and commands over MQTT. Topics and messages: docs/mqtt.md.

Without I/O: `topics`, `messages`, `encode`, `commands`, `happenings`. With it: `spool` (disk), `connection` and `part` (sockets).
"""
