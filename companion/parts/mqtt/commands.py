"""Decode commands from the broker, check them and carry each out once. No sockets and no clocks.

A command names the run of the service that it is meant for and its expiry, both in the terms of the drone's own messages:
no wall clock has to be right for a late command to be refused, and one from before a restart is never carried out. If a key is
set, the command must be signed as well; an unsigned one leaves no trace but a count and an answer.
"""

import hmac
from collections import Counter, OrderedDict
from dataclasses import dataclass, field
from typing import Protocol

import msgspec

from companion.parts.mqtt.messages import (
    AbortCommand,
    Command,
    CommandReply,
    PauseCommand,
    Refusal,
    SetPathCommand,
    SetRecordingCommand,
    StartCommand,
)
from companion.parts.mqtt.signature import Forged, Unsigned, verified
from companion.parts.mqtt.topics import Topics
from estimator.contracts.estimates import PathName
from estimator.contracts.time import MonoNs, after, seconds_between

LONGEST_BYTES = 4096
FARTHEST_S = 60.0
"""The longest time that a command may stay valid, s."""
REMEMBERED = 4096
"""The number of answers kept for repeated commands: more than can arrive while one of them is still valid."""

_decoder = msgspec.json.Decoder(Command)


class Operated(Protocol):
    """The pilot's operations for an operator; each returns None if it was carried out, else the reason why it cannot be."""

    def start(self) -> str | None: ...

    def pause(self) -> str | None: ...

    def abort(self) -> str | None: ...

    def steer_by(self, path: PathName) -> str | None: ...

    def record(self, on: bool) -> str | None: ...


@dataclass(frozen=True, slots=True)
class HandledCommand:
    """The outcome of one message on the command topic."""

    reply: CommandReply
    topic: str
    """The topic that the answer is published on."""
    command: str | None
    """The name of the command; None if it could not be read."""
    repeated: bool = False


@dataclass(slots=True)
class CommandHandler:
    """Checks, carries out and answers commands.

    Args:
        session: the id of this run of the service that everyone may read.
        run: the id of this run that only those who may command can read.
        key: the key that commands are signed with; None if the broker decides who may send them.
    """

    topics: Topics
    session: str
    operated: Operated
    run: str
    key: bytes | None = field(default=None, repr=False)
    _answered: OrderedDict[str, HandledCommand] = field(default_factory=OrderedDict)
    counts: Counter[str] = field(default_factory=Counter)

    def take(self, payload: bytes, now: MonoNs, *, retained: bool = False, reply_to: str | None = None) -> HandledCommand:
        """Check one message, and carry it out if every check passes.

        Args:
            retained: whether the broker had retained the message; its sender may be long gone.
            reply_to: the response topic of MQTT 5, used if the command itself names none.
        """
        handled = self._handle(payload, now, retained, reply_to)
        self.counts["repeated" if handled.repeated else handled.reply.reason or "accepted"] += 1
        return handled

    def _handle(self, payload: bytes, now: MonoNs, retained: bool, reply_to: str | None) -> HandledCommand:
        def refuse(
            reason: Refusal, words: str, of: str | None = None, name: str | None = None, to: str | None = None
        ) -> HandledCommand:
            answer = CommandReply(session=self.session, at_ns=now, id=of, accepted=False, reason=reason, text=words)
            return HandledCommand(answer, to or self.topics.reply, name)

        if len(payload) > LONGEST_BYTES:
            return refuse("too_long", f"{len(payload)} bytes, at most {LONGEST_BYTES} are read")
        if self.key is not None:
            try:
                payload = verified(self.key, self.topics.command, payload)
            except Unsigned:
                return refuse("unsigned", "commands are signed here: the signature, a space, the command")
            except Forged:
                return refuse("bad_signature", "the signature is not that of this topic, command and key")
        try:
            command = _decoder.decode(payload)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as why:
            return refuse("malformed", str(why)[:200], _id_in(payload))
        name = command.__struct_config__.tag
        assert isinstance(name, str)
        wished = command.reply_to or reply_to
        if wished is not None and not self.topics.allows_reply(wished):
            return refuse("reply_elsewhere", f"answers go to {self.topics.reply} or one name below it", command.id, name)
        to = wished or self.topics.reply
        if (known := self._answered.get(command.id)) is not None:
            return HandledCommand(known.reply, to, name, repeated=True)
        if retained:
            handled = refuse("retained", "a retained command is never carried out", command.id, name, to)
        elif not hmac.compare_digest(command.run.encode(errors="replace"), self.run.encode()):
            handled = refuse("other_run", "meant for another run of the service", command.id, name, to)
        elif command.expires_ns < now:
            late_s = seconds_between(MonoNs(command.expires_ns), now)
            handled = refuse("expired", f"came {late_s:.3g} s after it had expired", command.id, name, to)
        elif command.expires_ns > after(now, FARTHEST_S):
            handled = refuse("expiry_too_far", f"it may expire {FARTHEST_S:.0f} s from now at most", command.id, name, to)
        elif (cannot := self._carry_out(command)) is not None:
            handled = refuse("not_possible", cannot, command.id, name, to)
        else:
            done = CommandReply(session=self.session, at_ns=now, id=command.id, accepted=True, reason=None, text=f"{name} done")
            handled = HandledCommand(done, to, name)
        self._answered[command.id] = handled
        if len(self._answered) > REMEMBERED:
            self._answered.popitem(last=False)
        return handled

    def _carry_out(self, command: Command) -> str | None:
        match command:
            case StartCommand():
                return self.operated.start()
            case PauseCommand():
                return self.operated.pause()
            case AbortCommand():
                return self.operated.abort()
            case SetPathCommand():
                return self.operated.steer_by(command.path)
            case SetRecordingCommand():
                return self.operated.record(command.on)


def _id_in(payload: bytes) -> str | None:
    """Return the id of a command that is otherwise malformed, so that its sender can recognize the command."""
    try:
        data = msgspec.json.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    found = data.get("id") if isinstance(data, dict) else None
    return found if isinstance(found, str) and len(found) <= 64 else None
