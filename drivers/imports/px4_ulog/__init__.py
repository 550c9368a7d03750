"""Read PX4's logs (ULog) through pyulog: their samples, and their parameters, texts and events."""

from drivers.imports.px4_ulog.history import read_history as read_history
from drivers.imports.px4_ulog.samples import read as read
