"""A channel that the outside world may break: run it, and when it breaks run it again, later and later."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import NoReturn

from estimator.contracts.errors import Recoverable
from estimator.contracts.ports import Clock
from estimator.contracts.time import seconds_between

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class BackOff:
    """Waits between attempts: doubled from the first to the most, and the first again after a run of that length."""

    first_s: float
    most_s: float


async def reconnect(
    name: str, body: Callable[[], Awaitable[None]], clock: Clock, back_off: BackOff, restarts: Counter[str], down: dict[str, str]
) -> NoReturn:
    """Run `body` for ever. `Recoverable`, `OSError` and a return by itself start it again; anything else passes through.

    `restarts[name]` counts; `down[name]` holds the reason while the channel waits.
    """
    wait_s = back_off.first_s
    while True:
        began = clock.now()
        try:
            await body()
            why: Exception = Recoverable("ended by itself")
        except (Recoverable, OSError) as failed:
            why = failed
        if seconds_between(began, clock.now()) > back_off.most_s:
            wait_s = back_off.first_s
        restarts[name] += 1
        down[name] = str(why) or type(why).__name__
        _log.warning("ardrone %s: %s; again in %.1f s", name, down[name], wait_s)
        await clock.sleep(wait_s)
        del down[name]
        wait_s = min(2.0 * wait_s, back_off.most_s)
