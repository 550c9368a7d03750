"""Make the page with its tools from the settings of a service."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from companion.base.connection_limits import ConnectionLimits
from companion.base.health import Health
from companion.guidance.pilot import Pilot
from companion.parts.page.calibration_tool import CalibrationTool
from companion.parts.page.endpoint import PageEndpoint
from companion.parts.page.settings_tool import SettingsTool
from companion.parts.page.tool import Tool, flying
from companion.settings.model import Settings
from companion.settings.settings_file import SettingsFile
from companion.tools.doctor.live import LiveExaminer
from estimator.contracts.ports import Clock

if TYPE_CHECKING:
    from drivers.mavlink.autopilot import Autopilot

import asyncio

from companion.base.observer import ProcessedFrame
from companion.parts.page.tool_messages import ExaminedReport, ExamineRequest, PageFinding, ToolRequest
from companion.parts.page.viewer import PageViewer
from companion.tools.doctor.live import Examination, TookOff
from companion.tools.doctor.snapshot import Snapshot
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


def make_page(
    settings: Settings,
    pilot: Pilot,
    health: Health,
    clock: Clock,
    vehicle: str,
    autopilot: Callable[[], Autopilot | None],
    settings_file: Path | None = None,
    limits: ConnectionLimits | None = None,
) -> PageEndpoint:
    """Return the page.

    Args:
        vehicle: the vehicle's name for the page.
        autopilot: returns the autopilot whose links are open; None while they are not.
        settings_file: the file that the settings were read from; None if there is none.

    Raises:
        BadInput: the token or the certificate cannot be read.
    """

    def in_flight() -> bool:
        return flying(pilot)

    def armed() -> bool:
        found = autopilot()
        return found is not None and found.condition.armed is True

    file = None if settings_file is None else SettingsFile(settings_file)
    tools: list[Tool] = [
        DoctorTool(LiveExaminer(settings, health, clock, autopilot, in_flight), clock, in_flight),
        SettingsTool(settings, file, in_flight, armed),
        CalibrationTool(pilot, clock, file, in_flight, armed),
    ]
    folder = Path(settings.recorder.folder)
    return PageEndpoint(settings.page, pilot, health, clock, vehicle, folder, limits, tools)
