"""The asyncio daemon: parts, supervision, signals, health."""
