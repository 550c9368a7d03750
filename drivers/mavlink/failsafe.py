"""The failsafe of the autopilot that is in force, by its HEARTBEAT, texts, events and fence reports, with its words. No I/O.

A failsafe counts while the vehicle is armed. HEARTBEAT says CRITICAL from its start to its end: in ArduPilot for radio, battery,
station, EKF, terrain, traffic and dead reckoning, in PX4 for each one by which its commander does something. What has no such
state (ArduPilot's fence, a loss of thrust) is there in texts and in FENCE_STATUS. ArduCopter reports the state up to 1 s before
the words, PX4 sends the cause as an EVENT. Words that follow a failsafe that was named already are of another one.

Sources: mavlink.io (HEARTBEAT, STATUSTEXT, EVENT, FENCE_STATUS); ArduPilot and PX4 for the texts and names of events, which were
read for how they behave.
"""

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass

from drivers.mavlink.dialect import Message, mav
from estimator.contracts.time import MonoNs, seconds_between

_CRITICAL = frozenset({int(mav.MAV_STATE_CRITICAL), int(mav.MAV_STATE_EMERGENCY)})
_NAMES = re.compile(
    r"failsafe|fence.*breach|breach.*fence|dead reckoning|ekf variance|gps glitch|thrust loss|yaw imbalance|crash"
    r"|battery.*(is low|critical|emergency|land)|no offboard|manual control l|gcs connection l",
    re.IGNORECASE,
)
_NAMES_NONE = re.compile(r"^(pre)?arm:|clear|stopped|regained|recovered|warning", re.IGNORECASE)
"""Texts about a failsafe that ends, that only warns, or that keeps a vehicle from arming."""
_AFTER_S = 2.0
"""Time after a failsafe without a name came in which a text names it, s; a later one names another."""
_TOGETHER_S = 0.5
"""Time between two texts or events of one failsafe, s; later ones, of the same words too, are of another."""
_WORDS_S = 5.0
"""Time for which a text names what comes after it, and a failsafe that only a text names counts as in force, s.

PX4 waits 5 s in Hold before it acts.
"""
_CAUSES = (
    "", "manual control lost", "ground station lost", "low battery", "critical battery", "emergency battery", "flight time low",
)  # fmt: skip
"""PX4's failsafe_cause_t."""
UNNAMED = "a failsafe"
_UNNAMED = ("", "Failsafe activated", UNNAMED)
"""Words that name no cause: others that come with them are of the same failsafe."""


def event_id(name: str) -> int:
    """Return the number that EVENT carries: component 1 and 24 bits of the name's FNV-1a hash. Source: PX4, Tools/px4events."""
    value = 0x811C9DC5
    for byte in name.encode():
        value = (value ^ byte) * 0x1000193 & 0xFFFFFFFF
    return 1 << 24 | value & 0xFFFFFF


_EVENTS: dict[int, Callable[[bytes], int]] = {
    event_id("commander_failsafe_enter"): lambda arguments: struct.unpack_from("<IBB", arguments)[2],
    event_id("commander_failsafe_enter_hold"): lambda arguments: struct.unpack_from("<IBHB", arguments)[3],
    **{
        event_id(f"commander_failsafe_enter_{name}"): lambda arguments: 0
        for name in ("generic", "generic_hold", "autopilot_disengaged")
    },
}
"""Readers of the cause in the arguments of each event by which PX4 reports that a failsafe acts."""


@dataclass(frozen=True, slots=True)
class Failsafe:
    """A failsafe in force."""

    since: MonoNs
    """Time of the first report of it."""
    words: str
    """The autopilot's own words for it."""


class FailsafeWatch:
    """Follows one autopilot's reports."""

    def __init__(self) -> None:
        self.now: Failsafe | None = None
        """The failsafe in force; None while there is none."""
        self.newest: Failsafe | None = None
        """The newest one, in force or over."""
        self._critical = self._breached = self._armed = False
        self._newest_words: tuple[MonoNs, str] | None = None
        """The newest text that names one, and its time."""

    def on_heartbeat(self, m: Message, at: MonoNs) -> None:
        """Take the autopilot's own HEARTBEAT."""
        self._critical, self._armed = m.system_status in _CRITICAL, bool(m.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
        self._judge(at)

    def on_fence(self, m: Message, at: MonoNs) -> None:
        """Take a FENCE_STATUS."""
        self._breached = bool(m.breach_status)
        self._judge(at)

    def on_event(self, m: Message, at: MonoNs) -> None:
        """Take an EVENT."""
        if (cause_in := _EVENTS.get(int(m.id))) is not None:
            cause = cause_in(bytes(m.arguments))
            self._names(_CAUSES[cause] if cause < len(_CAUSES) else "", at)

    def on_text(self, text: str, at: MonoNs) -> None:
        """Take a whole STATUSTEXT."""
        if _NAMES.search(text) and not _NAMES_NONE.search(text):
            self._names(text.strip(), at)

    def _names(self, words: str, at: MonoNs) -> None:
        newest_words, now = self._newest_words, self.now
        together = newest_words is not None and seconds_between(newest_words[0], at) <= _TOGETHER_S
        if words in _UNNAMED:
            # PX4's text says less than the event that comes with it.
            words = newest_words[1] if newest_words is not None and together else words or UNNAMED
        self._newest_words = at, words
        was_named = now is not None and newest_words is not None and newest_words[0] >= now.since
        if now is not None and not together and (was_named or seconds_between(now.since, at) > _AFTER_S):
            self.now = None  # another one
        self._judge(at)

    def _judge(self, at: MonoNs) -> None:
        newest_words = self._newest_words
        lasts = newest_words is not None and seconds_between(newest_words[0], at) <= _WORDS_S
        if not self._armed or not (self._critical or self._breached or lasts):
            self.now = None
            return
        unnamed = "the fence is breached" if self._breached else UNNAMED
        words = newest_words[1] if newest_words is not None and lasts else unnamed if self.now is None else self.now.words
        if self.now is None or words != self.now.words:
            self.now = Failsafe(at if self.now is None else self.now.since, words)
        self.newest = self.now
