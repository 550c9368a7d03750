"""A drone in miniature on loopback: the four ports, acknowledge bit, watchdog and bootstrap, and a record of what it was told."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from typing import Any

from drivers.ardrone import at, control
from drivers.ardrone import navdata as nd
from drivers.ardrone.counters import Refusal
from drivers.ardrone.options import ArDroneOptions
from drivers.clock import SystemClock
from sitl.emulators.ardrone.server import DatagramPort, StreamPort
from tests.support.waiting import answering

HOST = "127.0.0.1"


class FakeArDrone:
    """Flies by word alone: REF bit 9 makes it fly after `take_off_s`, REF without it lands it at once."""

    def __init__(self) -> None:
        self.state = nd.NavdataState.NAVDATA_BOOTSTRAP | nd.NavdataState.COM_WATCHDOG
        self.control = nd.ControlState.LANDED
        self.sequence = 0
        self.clock_us = 5_000_000
        self.commands: list[tuple[int, at.AtCommand]] = []
        self.refused: list[Refusal] = []
        self.configuration = {"general:num_version_soft": "2.4.8"}
        self.configured_in_order: list[str] = []
        self.ids_before_config: list[at.ConfigIds | None] = []
        self.counters: Counter[str] = Counter()
        """The counters of its ports."""
        self.silent = False
        self.deaf_to_config = False
        self.forces_ref = True
        self.clips: list[bytes] = []
        self.video_pause_s = 0.004
        self.video_writers: list[asyncio.StreamWriter] = []
        self.vx_mm_s = 0.0
        self.altitude_mm = 900
        self.text = StreamPort("control", self.counters, clients_max=8, backlog_max=1 << 16)
        """The port of the configuration."""
        self._ids: at.ConfigIds | None = None
        self._navdata = DatagramPort("navdata", SystemClock().now, self.counters, backlog_max=1 << 16)

    def of(self, kind: type[Any]) -> list[Any]:
        """Return every command of a kind so far."""
        return [c for _, c in self.commands if isinstance(c, kind)]

    def forget(self) -> None:
        """Restart the drone, as after a change of its battery."""
        self.state = nd.NavdataState.NAVDATA_BOOTSTRAP | nd.NavdataState.COM_WATCHDOG
        self.control = nd.ControlState.LANDED
        self.sequence = 0
        self.clock_us = 1_000_000
        self.configured_in_order.clear()

    def datagram(self) -> bytes:
        """Return the next one."""
        self.sequence += 1
        self.clock_us += 5_000
        if self.state & nd.NavdataState.NAVDATA_BOOTSTRAP:
            return nd.encode(nd.Navdata(self.state, self.sequence))
        word, tags = self.control.word, (0,) if self.state & nd.NavdataState.NAVDATA_DEMO else (0, 1, 3, 10)
        navdata = nd.Navdata(
            self.state, self.sequence, tags, ctrl_state=word, battery_percent=80, altitude_mm=self.altitude_mm,
            vx_mm_s=self.vx_mm_s, clock=nd.clock_of_us(self.clock_us), az_mg=-1000.0, altitude_raw_mm=900,
        )  # fmt: skip
        return nd.encode(navdata)

    def _on_datagram(self, data: bytes, addr: Any) -> None:
        for result in at.decode(data):
            if isinstance(result, Refusal):
                self.refused.append(result)
                continue
            self.commands.append(result)
            self._obey(result[1])

    def _obey(self, command: at.AtCommand) -> None:
        if isinstance(command, at.ConfigIds):
            self._ids = command
            return
        if isinstance(command, at.Config) and not self.deaf_to_config and not self.state & nd.NavdataState.COMMAND_ACK:
            self.configuration[command.key] = command.value
            self.configured_in_order.append(command.key)
            self.ids_before_config.append(self._ids)
            self.state |= nd.NavdataState.COMMAND_ACK
        elif isinstance(command, at.Ctrl) and command.mode == at.CTRL_ACK:
            self.state &= ~(nd.NavdataState.COMMAND_ACK | nd.NavdataState.NAVDATA_BOOTSTRAP)
        elif isinstance(command, at.Ctrl) and command.mode == at.CTRL_CONFIGURATION:
            self.text.send(control.render(self.configuration))
        elif isinstance(command, at.ComWdg):
            self.state &= ~nd.NavdataState.COM_WATCHDOG
        elif isinstance(command, at.Ref) and self.forces_ref:
            if command.take_off and not self.state & nd.NavdataState.FLYING:
                self.state |= nd.NavdataState.FLYING
                self.control = nd.ControlState.HOVERING
            elif not command.take_off:
                self.state &= ~nd.NavdataState.FLYING
                self.control = nd.ControlState.LANDED
        self._ids = None

    async def _video(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.video_writers.append(writer)
        with suppress(OSError):
            for clip in self.clips:
                if writer.is_closing():
                    break
                writer.write(clip)
                await asyncio.sleep(self.video_pause_s)
            await reader.read()
        writer.close()

    def drop_video(self) -> None:
        """Cut the connections of the video."""
        for writer in self.video_writers:
            writer.close()

    @asynccontextmanager
    async def on_loopback(self, **options: Any) -> AsyncIterator[ArDroneOptions]:
        """Serve; yields options that lead here, patient for milliseconds only."""
        at_port = DatagramPort("at", SystemClock().now, self.counters, take=self._on_datagram)
        async with AsyncExitStack() as stack, answering(self._video) as video_port:
            fast: dict[str, Any] = {
                "host": HOST,
                "navdata_port": await self._navdata.listen(HOST, 0, stack),
                "at_port": await at_port.listen(HOST, 0, stack),
                "video_port": video_port,
                "control_port": await self.text.listen(HOST, 0, stack),
                "command_period_s": 0.01,
                "navdata_silence_s": 0.1,
                "reopen_after_s": 0.4,
                "video_silence_s": 0.3,
                "config_timeout_s": 0.5,
                "restart_first_s": 0.02,
                "restart_most_s": 0.1,
                "video_settle_s": 0.0,
            }
            ticker = asyncio.create_task(self._run())
            try:
                yield ArDroneOptions(**(fast | options))
            finally:
                ticker.cancel()
                await asyncio.gather(ticker, return_exceptions=True)

    async def _run(self) -> None:
        loop, before = asyncio.get_running_loop(), asyncio.get_running_loop().time()
        while True:
            await asyncio.sleep(0.005)
            before, slept_us = loop.time(), round(1e6 * (loop.time() - before))
            self.clock_us += max(0, slept_us - 5_000)  # a busy machine sleeps longer, and a drone's clock goes on
            if self._navdata.busy and not self.silent:
                self._navdata.send(self.datagram())
