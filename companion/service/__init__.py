"""The asyncio daemon, and the service that is assembled around it from the settings."""
