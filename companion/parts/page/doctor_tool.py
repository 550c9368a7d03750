"""Diagnose the running service from the page."""

import asyncio
from contextlib import closing

from msgspec import structs

from companion.base.health import HealthSnapshot
from companion.base.worker import Worker
from companion.parts.page.ground_tools import NO_EXAMINATION_IN_FLIGHT
from companion.parts.page.messages import ExaminedReport, ExamineRequest, PageFinding, ToolRequest
from companion.parts.page.viewer import PageService, PageViewer, Tool
from companion.settings.model import Settings
from companion.tools.doctor.diagnose import counted, diagnose
from companion.tools.doctor.gather import examine_open
from companion.tools.doctor.gather_service import running_service
from companion.tools.doctor.snapshot import LinkSnapshot, Snapshot
from drivers.mavlink.options import autopilot_of
from estimator.contracts.time import MonoNs, seconds_between

EXAMINATION_ENDED = "the vehicle took off, which ends the examination"

_AGAIN_S = 5.0
"""A younger diagnosis is used again."""
LISTENING_S = 4.0
"""Time for which an autopilot is listened to."""
_LOOKS_S = 0.1  # interval at which a flight that begins ends it


class DoctorTool(Tool):
    """Examines the setup from inside the running service: over the links that it has open, on the ground alone.

    The links of a service cannot be opened twice, and requests to the autopilot share them with the flight. An examination
    therefore needs a vehicle that stands, and a take-off ends it at once.
    """

    kinds = (ExamineRequest,)

    def __init__(self, service: PageService) -> None:
        self._service = service
        self._waiting: list[PageViewer] = []
        self._asked = asyncio.Event()
        self._newest: tuple[MonoNs, ExaminedReport] | None = None

    def ask(self, viewer: PageViewer, request: ToolRequest) -> None:
        if self._service.flying:
            viewer.tell(ExaminedReport(text=NO_EXAMINATION_IN_FLIGHT))
        elif self._newest is not None and seconds_between(self._newest[0], self._service.clock.now()) < _AGAIN_S:
            viewer.tell(self._newest[1])
        else:
            viewer.tell(ExaminedReport(text="examining", busy=True))
            if viewer not in self._waiting:
                self._waiting.append(viewer)
            self._asked.set()

    async def run(self) -> None:
        while True:
            await self._asked.wait()
            async with asyncio.TaskGroup() as group:
                examining = group.create_task(self._examined())
                while not examining.done() and not self._service.flying:
                    await asyncio.wait([examining], timeout=_LOOKS_S)
                examining.cancel()
            report = ExaminedReport(text=EXAMINATION_ENDED) if examining.cancelled() else examining.result()
            if not examining.cancelled():
                self._newest = self._service.clock.now(), report
            self._asked.clear()
            waiting, self._waiting = self._waiting, []
            for viewer in waiting:
                viewer.tell(report)

    async def _examined(self) -> ExaminedReport:
        """Examine the setup, which takes some seconds."""
        snapshot, service = Snapshot(0.0), self._service
        autopilot, vehicle = service.autopilot(), autopilot_of(service.settings.vehicle)
        if autopilot is not None and vehicle is not None:
            channel = service.settings.operator.switch.channel
            snapshot = await examine_open(autopilot, vehicle.system_id, service.clock, LISTENING_S, channel)
        elif vehicle is not None:
            part = service.health.snapshot().parts.get("vehicle")
            why = "" if part is None else part.last_error
            snapshot = Snapshot(0.0, (LinkSnapshot(vehicle.links, down=why or "is not open yet"),))
        with closing(Worker("doctor")) as worker:
            return await worker.run(_report, snapshot, service.settings, service.health.snapshot())


def _report(snapshot: Snapshot, settings: Settings, health: HealthSnapshot) -> ExaminedReport:
    findings = diagnose(structs.replace(snapshot, service=running_service(settings, health)))
    return ExaminedReport(
        text=f"{counted(snapshot, len(findings)).replace(chr(10), '; ')}. {_about(snapshot)}",
        findings=tuple(
            PageFinding(rule=one.rule, severity=one.severity.name.lower(), what=one.what, fix=one.fix) for one in findings
        ),
    )


def _about(snapshot: Snapshot) -> str:
    """Return what was examined, as a sentence."""
    a, sync = snapshot.autopilot, snapshot.sync
    if a is None:
        received = ", no autopilot is connected" if snapshot.links else ""
        return f"Examined: settings and their files, camera{received}."
    firmware = "" if a.firmware is None else " " + ".".join(map(str, a.firmware))
    clock = "" if sync is None or sync.round_trip_s is None else f", clock round trip {1e3 * sync.round_trip_s:.0f} ms"
    return f"Examined: {a.stack}{firmware}, system {a.system}, {len(a.parameters)} parameters{clock}; settings, camera."
