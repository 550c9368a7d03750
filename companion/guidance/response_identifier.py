"""Keeps the identification of the vehicle's response for a pilot: fed by samples and commands, asked for what is known."""

from __future__ import annotations

from companion.base.mission import GROUND, State
from companion.base.response_in_use import ResponseInUse, ResponseState
from companion.guidance import response_watch
from companion.settings.guidance import GuidanceOptions
from companion.settings.response import TiltResponse
from estimator.contracts.commands import Command
from estimator.contracts.time import MonoNs, Stamp

_ON_DECK = (*GROUND, State.PRESS, State.DOWN)


class ResponseIdentifier:
    """Identifies the response of one vehicle through all its flights.

    Args:
        given: the response of the vehicle's file.
    """

    def __init__(self, given: TiltResponse, guidance: GuidanceOptions) -> None:
        self._watch = response_watch.begun(given, guidance.follow_deck.delay_known_s)
        known = self._watch.in_use.state is ResponseState.KNOWN
        # That the file holds is nothing to tell; that the gains are softer is.
        self._told = self._watch.in_use if known else None
        self.retune(guidance)

    def retune(self, guidance: GuidanceOptions) -> None:
        """Use other settings from now on; what is known stays."""
        # The thesis' controller commands velocities, which tell nothing of the tilt.
        self._on = guidance.follow_deck.identify and guidance.controller != "pid"
        self._known_s = guidance.follow_deck.delay_known_s

    @property
    def in_use(self) -> ResponseInUse | None:
        """The response to fly by; None if it is not identified."""
        return self._watch.in_use if self._on else None

    def on_attitude(self, stamp: Stamp, lean_m_s2: tuple[float, float]) -> None:
        """Take a reported tilt, as an acceleration forward and right."""
        if self._on:
            self._watch = response_watch.reported(self._watch, stamp, lean_m_s2)

    def on_take_off(self) -> None:
        """Begin another flight with what is known."""
        self._watch = response_watch.landed(self._watch)

    def on_command(self, now: MonoNs, command: Command | None, state: State) -> ResponseInUse | None:
        """Take the command of a guidance cycle; return the response in use when it is another one than last told, else None."""
        if not self._on:
            return None
        on_deck = state in _ON_DECK
        self._watch = response_watch.asked(self._watch, now, None if on_deck else command, self._known_s)
        if on_deck or self._watch.in_use is self._told:
            return None
        self._told = self._watch.in_use
        return self._told
