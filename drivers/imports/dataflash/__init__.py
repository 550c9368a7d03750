"""Read ArduPilot's dataflash logs through pymavlink: their samples, and their parameters, texts and events."""

from drivers.imports.dataflash.history import read_history as read_history
from drivers.imports.dataflash.samples import read as read
