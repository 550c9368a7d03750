"""Show how far a campaign is: a bar by rich on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from contextlib import AbstractContextManager
from importlib.util import find_spec
from types import TracebackType
from typing import Any

_SAY_EACH_S = 30.0


class CampaignProgress(AbstractContextManager["CampaignProgress"]):
    """Progress on standard error.

    Args:
        total: number of flights of the campaign.
        kept: number of flights that an earlier session has flown.
        quiet: nothing is shown.
    """

    def __init__(self, total: int, kept: int, quiet: bool) -> None:
        self._total, self._kept, self._quiet = total, kept, quiet
        self._flown = self._failed = 0
        self._began_s = self._said_s = time.monotonic()
        self._bar: Any = None
        self._row: Any = None

    def __enter__(self) -> CampaignProgress:
        if not self._quiet and sys.stderr.isatty() and find_spec("rich") is not None:
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]}"),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(elapsed_when_finished=True),
            )
            self._bar = Progress(*columns, console=Console(stderr=True))
            self._bar.start()
            self._row = self._bar.add_task("flights", total=self._total, completed=self._kept, rate="")
        return self

    def take(self, failed: bool) -> None:
        """Count one more flight."""
        self._flown += 1
        self._failed += failed
        now_s = time.monotonic()
        rate = f"{60.0 * self._flown / max(1e-9, now_s - self._began_s):.1f} a minute, {self._failed} failed"
        if self._bar is not None:
            self._bar.update(self._row, advance=1, rate=rate)
        elif not self._quiet and now_s - self._said_s >= _SAY_EACH_S:
            self._said_s = now_s
            sys.stderr.write(f"{self._kept + self._flown} of {self._total} flights, {rate}\n")

    def __exit__(self, kind: type[BaseException] | None, why: BaseException | None, traceback: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.stop()
