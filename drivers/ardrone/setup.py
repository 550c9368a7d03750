"""Configure the drone for flight: end its bootstrap, and set each configuration key by its acknowledge handshake.

`ControlChannel` reads the configuration back over TCP port 5559 and compares it with the one that was set.
"""

import asyncio
import logging
from collections.abc import Callable, Iterator, Sequence

from drivers.ardrone import control
from drivers.ardrone.at import CTRL_ACK, CTRL_CONFIGURATION, AtCommand, Config, ConfigIds, Ctrl, Misc, Pmode
from drivers.ardrone.command_channel import CommandChannel
from drivers.ardrone.counters import Counters
from drivers.ardrone.navdata import NavdataState
from drivers.ardrone.navdata_channel import NavdataChannel
from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.errors import Recoverable
from estimator.contracts.time import Clock, MonoNs, seconds_between

_log = logging.getLogger(__name__)
_AGAIN_S = 0.1
"""A command of the handshake is repeated after this long without effect."""
_LOOK_S = 0.005  # time between two looks at what the drone has reported meanwhile
_TEXT_MAX = 1 << 16  # longest list of settings that is read, bytes
_SILENCE_S = 0.5  # a list of settings has ended when nothing has come for this long
_MORE_S = 0.1  # time for which the control port is read at once while it is held open
_FIRMWARE = "general:num_version_soft"
_TRIES = 3
"""The number of times that the drone is configured again because a key reads back wrongly."""


def configuration_commands(options: ArDroneOptions) -> Iterator[tuple[str, list[AtCommand]]]:
    """Yield each key that is set, in order, with the commands that set it.

    These are CONFIG, and CONFIG_IDS before it once a session is in use, without which the drone refuses the session's keys.
    """
    in_use = False
    for key, value in options.configuration().items():
        in_use = in_use or (not key.startswith("custom:") and key != "general:navdata_demo")
        prefix: list[AtCommand] = [ConfigIds(*options.IDS)] if in_use else []
        yield key, [*prefix, Config(key, value)]


class Setup:
    """Configures the drone when the link is new and whenever the drone has restarted.

    `needed` is set while there is something to do, `done` while the drone is known to be configured; `handshake` is held by
    every user of the acknowledge bit.
    """

    def __init__(
        self, options: ArDroneOptions, clock: Clock, counters: Counters, commands: CommandChannel, navdata: NavdataChannel
    ) -> None:
        self._o = options
        self._clock = clock
        self._counters = counters
        self._commands = commands
        self._navdata = navdata
        self.needed = asyncio.Event()
        self.needed.set()
        self.done = asyncio.Event()
        self.done_at: MonoNs | None = None
        self.rounds = 0
        """The number of times that the drone was configured."""
        self.handshake = asyncio.Lock()

    def restart(self) -> None:
        """Configure the drone again, because it has lost its configuration or never received it."""
        self.done.clear()
        self.done_at = None
        self.needed.set()

    def on_state(self, state: int) -> None:
        """Configure again if the state bits are not those of a configured drone."""
        if self.done.is_set() and state & (NavdataState.NAVDATA_BOOTSTRAP | NavdataState.NAVDATA_DEMO):
            self.restart()

    async def run(self) -> None:
        """Configure the drone whenever that is needed.

        Raises:
            Recoverable: a key was not acknowledged in `config_timeout_s`; all of them are sent again.
        """
        while True:
            await self.needed.wait()
            while self._navdata.newest is None or not self._commands.up:
                await self._clock.sleep(_LOOK_S)
            self.needed.clear()
            try:
                async with self.handshake:
                    await self._configure()
            except Recoverable:
                self.needed.set()
                raise
            if not self.needed.is_set():
                self.rounds += 1
                self.done_at = self._clock.now()
                self.done.set()

    async def _configure(self) -> None:
        self._commands.send([Pmode(2), Misc()])
        for key, commands in configuration_commands(self._o):
            await self._set(commands, key)

    async def _set(self, command: Sequence[AtCommand], key: str) -> None:
        began = self._clock.now()
        await self._until(lambda state: not state & NavdataState.COMMAND_ACK, [Ctrl(CTRL_ACK)], began, key)
        await self._until(lambda state: bool(state & NavdataState.COMMAND_ACK), command, began, key)
        await self._until(lambda state: not state & NavdataState.COMMAND_ACK, [Ctrl(CTRL_ACK)], began, key)
        self._counters.config_acknowledged += 1

    async def _until(self, reached: Callable[[int], bool], command: Sequence[AtCommand], began: MonoNs, key: str) -> None:
        sent: MonoNs | None = None
        while not reached(self._state()):
            now = self._clock.now()
            if seconds_between(began, now) > self._o.config_timeout_s:
                self._counters.config_timeouts += 1
                raise Recoverable(f"{key} was not acknowledged in {self._o.config_timeout_s} s")
            if sent is None or seconds_between(sent, now) > _AGAIN_S:
                self._commands.send(command)
                sent = now
            await self._clock.sleep(_LOOK_S)

    def _state(self) -> int:
        self._navdata.take_waiting()
        newest = self._navdata.newest
        return 0 if newest is None else newest.state

    async def clear_acknowledge(self) -> None:
        """Clear the acknowledge bit for the control channel, which holds `handshake`.

        Raises:
            Recoverable: the bit was not cleared within `config_timeout_s`.
        """
        await self._until(
            lambda state: not state & NavdataState.COMMAND_ACK, [Ctrl(CTRL_ACK)], self._clock.now(), "the acknowledge bit"
        )


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
                    await self._more(reader, _MORE_S)
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
