"""`decklander watch`: watch drones live in the terminal, over MQTT."""

from __future__ import annotations

import argparse
import asyncio
import os
import shutil
import sys
import time
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from companion.cli.options import option
from estimator.contracts.errors import BadInput, Recoverable, refused

if TYPE_CHECKING:
    from companion.parts.mqtt.connection import BrokerEndpoint
    from companion.settings.links import MqttSettings

_REDRAW_S = 0.25
_BACK_OFF_S = 1.0
_LINE_EACH_S = 1.0
_INCOMING = 2000
_CLEAR, _HOME, _TO_END, _BELOW, _HIDE, _SHOW = "\x1b[2J", "\x1b[H", "\x1b[K", "\x1b[J", "\x1b[?25l", "\x1b[?25h"


DESCRIPTION = (
    "Show what drones publish on an MQTT broker: a full screen on a terminal, else a line per second and a line "
    "per event. Take the broker from a settings file or from the options. Exit code 1 if --seconds pass without a "
    "connection to the broker."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    option(parser, "--config FILE", "read the broker and the credentials from [mqtt] of this settings file")
    option(parser, "--host HOST", "host name or address of the broker (default: 127.0.0.1)")
    option(parser, "--port PORT", "port of the broker (default: 8883 with TLS, 1883 without)", type=int)
    option(parser, "--user USER", "user name")
    option(parser, "--password-file FILE", "read the password from this file", type=Path)
    option(parser, "--ca-file FILE", "trust the CAs in this file instead of the system's", type=Path)
    option(parser, "--plain-tcp", "connect without TLS")
    option(parser, "--drone NAME", "show only this drone (default: every drone on the broker)")
    option(parser, "--seconds S", "stop after this many seconds", type=float)


def run(args: argparse.Namespace) -> int:
    """Show drones until interrupted or until `--seconds` have passed.

    Returns:
        0, or 1 if the broker was never reached.

    Raises:
        BadInput: an option or the settings file is wrong, or a secret cannot be read.
    """
    from companion.parts.mqtt.connection import BrokerEndpoint
    from companion.parts.mqtt.messages import Topics
    from companion.settings.links import MqttSettings
    from companion.settings.load import load

    if args.config is not None:
        settings = load(args.config).mqtt
        if settings.transport == "off":
            raise BadInput(f"{args.config}: mqtt.transport is off")
    else:
        settings = MqttSettings(transport="tcp", port=1883) if args.plain_tcp else MqttSettings(transport="tls")
    settings = _changed(settings, args)
    if args.drone is not None:
        with refused("--drone", ValueError):
            Topics(args.drone)
    if args.seconds is not None and not 0 < args.seconds < 1e9:
        raise BadInput(f"--seconds must be more than 0, got {args.seconds}")
    endpoint = BrokerEndpoint.of(settings)
    out, live = sys.stdout, sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    from companion.base import event_loop

    return event_loop.run(_Watch(endpoint, args.drone, out, live).run(args.seconds))


def _changed(settings: MqttSettings, args: argparse.Namespace) -> MqttSettings:
    from msgspec import structs

    if args.port is not None and not 0 < args.port < 65536:
        raise BadInput(f"--port must be from 1 to 65535, got {args.port}")
    given = {
        "host": args.host,
        "port": args.port,
        "user": args.user,
        "password_file": None if args.password_file is None else str(args.password_file),
        "ca_file": None if args.ca_file is None else str(args.ca_file),
    }
    if args.password_file is not None and not (args.user or settings.user):
        raise BadInput("--password-file needs --user")
    return structs.replace(settings, **{key: value for key, value in given.items() if value is not None})


class _Watch:
    """Subscribe to the broker and show what arrives."""

    def __init__(self, endpoint: BrokerEndpoint, drone: str | None, out: TextIO, live: bool) -> None:
        from companion.parts.mqtt.messages import ROOT
        from companion.parts.mqtt.watch import WatchModel

        self._endpoint = endpoint
        self._model = WatchModel(drone)
        self._topic = f"{ROOT}/{drone or '+'}/+"
        self._out = out
        self._live = live
        self._printed_s: dict[str, float] = {}
        """Time at which the last line of each drone was printed, s on the monotonic clock."""
        self._reached = False
        """True if the broker ever accepted the connection."""

    async def run(self, seconds: float | None) -> int:
        """Show drones until cancelled, or for this many seconds; return the exit code."""
        if self._live:
            self._write(_HIDE + _CLEAR)
        else:
            sys.stderr.write(f"connecting to {self._where} ...\n")
        try:
            async with asyncio.timeout(seconds), asyncio.TaskGroup() as group:
                group.create_task(self._listen())
                if self._live:
                    group.create_task(self._draw())
        except TimeoutError:
            pass
        finally:
            self._write(_SHOW + "\n" if self._live else "")
        if not self._reached:
            raise Recoverable(self._model.trouble or f"no answer from {self._where} within {seconds:g} s{self._hint}")
        if not self._model.drones:
            sys.stderr.write(f"connected to {self._where}, but no drone published anything\n")
        return 0

    @property
    def _where(self) -> str:
        return f"broker {self._endpoint.host}:{self._endpoint.port} ({'plain TCP' if self._endpoint.tls is None else 'TLS'})"

    @property
    def _hint(self) -> str:
        return "; a broker that expects TLS does not answer plain TCP" if self._endpoint.tls is None else ""

    async def _listen(self) -> None:
        from aiomqtt import MqttError

        from companion.parts.mqtt.connection import connect

        while True:
            try:
                async with connect(self._endpoint, f"decklander-watch-{uuid.uuid4().hex[:8]}", incoming=_INCOMING) as connection:
                    await connection.subscribe_to(self._topic, qos=1, retained=True)
                    self._reached, self._model.connected, self._model.trouble = True, True, ""
                    async for publication in connection.publications():
                        self._take(publication.topic, publication.payload)
            except (Recoverable, MqttError) as why:
                trouble = f"{why}{self._hint}" if not self._reached else str(why)
                if not self._live and trouble != self._model.trouble:
                    sys.stderr.write(f"no connection: {trouble}\n")
                self._model.connected, self._model.trouble = False, trouble
            await asyncio.sleep(_BACK_OFF_S)

    def _take(self, topic: str, payload: bytes) -> None:
        from companion.parts.mqtt.watch import line

        now_s = time.monotonic()
        update = self._model.on_message(topic, payload, now_s)
        if update is None or self._live:
            return
        drone, event = update
        if event is not None or now_s - self._printed_s.get(drone.name, -_LINE_EACH_S) >= _LINE_EACH_S:
            if event is None:
                self._printed_s[drone.name] = now_s
            self._write(line(drone, event) + "\n")

    async def _draw(self) -> None:
        from companion.parts.mqtt.watch import screen

        while True:
            width, height = shutil.get_terminal_size()
            lines = screen(self._model, time.monotonic(), width, height - 1, colour="NO_COLOR" not in os.environ)
            self._write(_HOME + "".join(f"{text}{_TO_END}\r\n" for text in lines) + _BELOW)
            await asyncio.sleep(_REDRAW_S)

    def _write(self, text: str) -> None:
        self._out.write(text)
        self._out.flush()
