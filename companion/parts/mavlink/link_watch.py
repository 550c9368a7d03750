"""Say in flight what is wrong with the MAVLink links, by the doctor's rules: in the log, on the page and in status texts.

The counters are those of the last seconds, so that a fault that is over is said no more.
"""

import logging
from collections import deque
from typing import NoReturn

from msgspec import structs

from companion.base.health import Health
from companion.tools.doctor.finding import Finding, Severity
from companion.tools.doctor.gather import Notes, snapshot_of
from companion.tools.doctor.rules_links import WATCHED
from companion.tools.doctor.snapshot import LinkSnapshot, Snapshot
from drivers.mavlink.autopilot import Autopilot
from estimator.contracts.errors import Recoverable
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between

_log = logging.getLogger(__name__)

PART = "MAVLink links"
"""The watch's own name in health: it is down while something is wrong, and the flight does not need it."""
_EACH_S = 1.0
_WINDOW_S = 8.0
_FIRST_S = 6.0
"""Time for which is listened before anything is judged: a link and its first requests need some seconds."""
_AGAIN_S = 60.0
"""The shortest time between two log lines about the same."""
_COUNTED = tuple(name for name in LinkSnapshot.__struct_fields__ if name not in ("url", "down", "signed", "behind_s"))


class LinkWatch:
    """Judges the links of an open autopilot once a second.

    Args:
        wanted: the system id that the settings ask for; 0 for any.
    """

    def __init__(self, autopilot: Autopilot, wanted: int, health: Health, clock: Clock) -> None:
        self._autopilot, self._wanted, self._health, self._clock = autopilot, wanted, health, clock
        self._notes = Notes()
        self._began = clock.now()
        self._before: deque[tuple[MonoNs, tuple[LinkSnapshot, ...]]] = deque()
        self._found: dict[str, Finding] = {}
        self._logged: dict[str, MonoNs] = {}

    async def run(self) -> NoReturn:
        """Watch until cancelled."""
        self._autopilot.add_listener(self._notes.on_message)
        try:
            while True:
                await self._clock.sleep(_EACH_S)
                self._autopilot.links.contained.run("the watch of the links", "us", self._look)
        finally:
            self._autopilot.remove_listener(self._notes.on_message)
            if self._found:
                self._health.up(PART)

    def _look(self) -> None:
        now = self._clock.now()
        snapshot = snapshot_of(self._autopilot, self._notes, {}, self._wanted, seconds_between(self._began, now))
        self._before.append((now, snapshot.links))
        while len(self._before) > 2 and seconds_between(self._before[1][0], now) >= _WINDOW_S:
            self._before.popleft()
        if snapshot.seconds < _FIRST_S:
            return
        lately = structs.replace(snapshot, links=tuple(map(_since, self._before[0][1], snapshot.links)))
        self._tell({one.rule: one for rule in WATCHED if (one := rule(lately)) is not None and _matters(one, lately)}, now)

    def _tell(self, found: dict[str, Finding], now: MonoNs) -> None:
        before, self._found = self._found, found
        for rule, one in found.items():
            last = self._logged.get(rule)
            # The driver has logged a conflict already.
            if (
                rule not in before
                and rule not in (d.name for d in self._autopilot.id_conflicts)
                and (last is None or seconds_between(last, now) >= _AGAIN_S)
            ):
                self._logged[rule] = now
                _log.log(_LEVELS[one.severity], "MAVLink: %s; %s", one.what, one.fix)
        if found and found.keys() != before.keys():
            first = next(iter(found.values()))
            self._health.down(PART, Recoverable(f"{first.what}; {first.fix}"))
        elif before and not found:
            self._health.up(PART)
            _log.info("MAVLink: nothing is wrong with the links any more")


_LEVELS = {Severity.ERROR: logging.WARNING, Severity.WARNING: logging.WARNING, Severity.ADVICE: logging.INFO}


def _since(before: LinkSnapshot, now: LinkSnapshot) -> LinkSnapshot:
    """Return a link's counters since an earlier snapshot."""
    return structs.replace(now, **{name: getattr(now, name) - getattr(before, name) for name in _COUNTED})


def _matters(finding: Finding, snapshot: Snapshot) -> bool:
    """Return whether a finding is worth saying in flight: a spare link may be silent, and a conflict may block nothing."""
    if any(one.name == finding.rule for one in snapshot.id_conflicts):
        return True
    return finding.rule != "link-silent" or snapshot.autopilot is None
