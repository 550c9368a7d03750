"""The control channel reads the drone's configuration back over TCP port 5559 and compares it with the one that was set."""

from __future__ import annotations

import asyncio
import logging

from drivers.ardrone import control
from drivers.ardrone.at import CTRL_CONFIGURATION, Ctrl
from drivers.ardrone.command_channel import CommandChannel
from drivers.ardrone.counters import Counters
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.setup import Setup
from estimator.contracts.errors import Recoverable

_log = logging.getLogger(__name__)
_TEXT_MAX = 1 << 16
_SILENCE_S = 0.5
_LOOK_S = 0.1
_FIRMWARE = "general:num_version_soft"
_TRIES = 3
"""The number of times that the drone is configured again because a key reads back wrongly."""


class ControlChannel:
    """Reads the configuration after each setup; `configuration` holds the one that was read last."""

    def __init__(self, options: ArDroneOptions, counters: Counters, commands: CommandChannel, setup: Setup) -> None:
        self._o = options
        self._counters = counters
        self._commands = commands
        self._setup = setup
        self._tries = 0
        self.configuration: dict[str, str] = {}

    async def run(self) -> None:
        """Read once after each setup, on one connection as long as that lasts.

        Raises:
            Recoverable: the drone closed the connection or sent no text.
            OSError: no connection.
        """
        await self._setup.done.wait()
        async with asyncio.timeout(self._o.connect_timeout_s):
            reader, writer = await asyncio.open_connection(self._o.host, self._o.control_port, limit=_TEXT_MAX)
        try:
            while True:
                await self._setup.done.wait()
                rounds = self._setup.rounds
                async with self._setup.handshake:
                    await self._setup.clear_acknowledge()
                    self._commands.send([Ctrl(CTRL_CONFIGURATION)])
                    text = await self._read(reader)
                self._counters.control_reads += 1
                self._compare(control.parse(text))
                while self._setup.rounds == rounds:
                    await self._more(reader, _LOOK_S)
        finally:
            writer.close()

    async def _read(self, reader: asyncio.StreamReader) -> bytes:
        """Read up to the NUL byte; a drone that sends none has ended when it falls silent after a whole line."""
        text = b""
        wait_s = self._o.config_timeout_s
        while control.END not in text and len(text) < _TEXT_MAX:
            more = await self._more(reader, wait_s)
            if not more:
                if text.endswith(b"\n"):
                    break
                raise Recoverable(f"no configuration text for {wait_s} s")
            text += more
            wait_s = min(_SILENCE_S, self._o.config_timeout_s)
        return text

    @staticmethod
    async def _more(reader: asyncio.StreamReader, wait_s: float) -> bytes:
        """Return the bytes that arrive within the time; none if nothing arrives."""
        try:
            async with asyncio.timeout(wait_s):
                more = await reader.read(4096)
        except TimeoutError:
            return b""
        if not more:
            raise Recoverable("the drone closed the control connection")
        return more

    def _compare(self, read_back: dict[str, str]) -> None:
        self.configuration = read_back
        self._check_model(read_back.get(_FIRMWARE, ""))
        wrong = [key for key, asked in self._o.configuration().items() if key in read_back and not _same(asked, read_back[key])]
        if not wrong:
            self._tries = 0
            return
        self._counters.config_mismatches += len(wrong)
        _log.warning(
            "the AR.Drone reads back other values than it was configured with: %s",
            ", ".join(f"{k} = {read_back[k]}" for k in wrong),
        )
        if self._tries < _TRIES:
            self._tries += 1
            self._setup.restart()

    def _check_model(self, firmware: str) -> None:
        """Warn of a drone whose firmware is that of the other generation: its video is of another kind, on another protocol."""
        generation = firmware.partition(".")[0]
        if generation in ("1", "2") and generation != self._o.model[0]:
            self._counters.model_mismatches += 1
            _log.warning(
                'the drone has firmware %s, that of an AR.Drone %s.0, and vehicle.model is "%s": set vehicle.model = "%s.0", '
                "or no frame will arrive",
                firmware, generation, self._o.model, generation,
            )  # fmt: skip


def _same(asked: str, read_back: str) -> bool:
    a, b = control.number(asked), control.number(read_back)
    if a is None or b is None:
        return asked.strip() == read_back.strip()
    return abs(a - b) <= 1e-4 * max(1.0, abs(a))
