"""The doctor's findings on the page: one examination at a time, for every browser that asks, on the ground alone."""

import asyncio
from collections.abc import Callable

from companion.base.observer import ProcessedFrame
from companion.parts.page.tool_messages import ExaminedReport, ExamineRequest, PageFinding, ToolRequest
from companion.parts.page.viewer import PageViewer
from companion.tools.doctor.live import Examination, LiveExaminer, TookOff
from companion.tools.doctor.snapshot import Snapshot
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between

IN_FLIGHT = "the vehicle flies: the setup is examined on the ground; health says what is wrong now"
_AGAIN_S = 5.0
"""An examination that is younger is told again."""


class DoctorTool:
    """See the module's docstring.

    Args:
        flying: whether the vehicle flies now.
    """

    kinds: tuple[type, ...] = (ExamineRequest,)

    def __init__(self, examiner: LiveExaminer, clock: Clock, flying: Callable[[], bool]) -> None:
        self._examiner = examiner
        self._clock = clock
        self._flying = flying
        self._waiting: list[PageViewer] = []
        self._asked = asyncio.Event()
        self._newest: tuple[MonoNs, ExaminedReport] | None = None

    def ask(self, viewer: PageViewer, request: ToolRequest) -> None:
        if self._flying():
            viewer.tell(ExaminedReport(text=IN_FLIGHT))
        elif self._newest is not None and seconds_between(self._newest[0], self._clock.now()) < _AGAIN_S:
            viewer.tell(self._newest[1])
        else:
            viewer.tell(ExaminedReport(text="examining", busy=True))
            if viewer not in self._waiting:
                self._waiting.append(viewer)
            self._asked.set()

    def on_frame(self, processed: ProcessedFrame) -> None:
        pass

    async def run(self) -> None:
        while True:
            await self._asked.wait()
            try:
                report = _report(await self._examiner.examine())
                self._newest = self._clock.now(), report
            except TookOff as why:
                report = ExaminedReport(text=str(why))
            self._asked.clear()
            waiting, self._waiting = self._waiting, []
            for viewer in waiting:
                viewer.tell(report)


def _report(found: Examination) -> ExaminedReport:
    counted = f"{len(found.findings)} of {found.known}" if found.findings else f"none of {found.known}"
    return ExaminedReport(
        text=f"{counted} known faults found. {_about(found.snapshot)}",
        findings=tuple(
            PageFinding(rule=one.rule, severity=one.severity.name.lower(), what=one.what, fix=one.fix) for one in found.findings
        ),
    )


def _about(snapshot: Snapshot) -> str:
    """Return what was examined, as a sentence."""
    a, sync = snapshot.autopilot, snapshot.sync
    if a is None:
        heard = ", no autopilot is heard" if snapshot.links else ""
        return f"Examined: settings and their files, camera{heard}."
    firmware = "" if a.firmware is None else " " + ".".join(map(str, a.firmware))
    clock = "" if sync is None or sync.round_trip_s is None else f", clock round trip {1e3 * sync.round_trip_s:.0f} ms"
    return f"Examined: {a.stack}{firmware}, system {a.system}, {len(a.parameters)} parameters{clock}; settings, camera."
