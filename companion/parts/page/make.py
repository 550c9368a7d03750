"""Make the page with its tools from the settings of a service: the guided calibration and the doctor among them."""

from __future__ import annotations

import asyncio
import math
import tomllib
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from companion.base.health import Health, HealthSnapshot
from companion.base.http_server import HttpServer
from companion.base.observer import ProcessedFrame
from companion.base.worker import Worker
from companion.guidance.pilot import Pilot
from companion.parts.page.endpoint import PageEndpoint, flying
from companion.parts.page.messages import (
    CalibrationReport,
    CalibrationRequest,
    ExaminedReport,
    ExamineRequest,
    PageFinding,
    ToolRequest,
)
from companion.parts.page.recordings import Recordings, ReportMaker
from companion.parts.page.settings_tool import ARMED, NO_FILE, SettingsTool
from companion.parts.page.viewer import PageViewer, Tool
from companion.settings.model import Settings
from companion.settings.settings_file import SettingsFile
from companion.tools.calibrate.board import Board
from companion.tools.calibrate.camera_file import text
from companion.tools.calibrate.guide import Guide, GuideState
from companion.tools.doctor.snapshot import LinkSnapshot, Snapshot
from drivers.mailbox import Latest
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.errors import BadInput, DecklanderError
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.camera import Camera

if TYPE_CHECKING:
    from drivers.mavlink.autopilot import Autopilot

NO_CALIBRATION_IN_FLIGHT = "the vehicle flies: the camera is calibrated on the ground"
TOOK_OFF = "the vehicle took off, which ends the calibration"
NAME = "camera_calibrated.toml"
"""The file that is written beside the settings."""
_FRAME_S = 0.2
"""Interval of the frames that are looked at: a person moves a board no faster."""
_MARKER = 0.72
"""Side of a ChArUco marker as a share of a square, as `decklander pad print --board charuco` prints it."""


@dataclass(slots=True)
class _Run:
    """A calibration under way."""

    guide: Guide
    board: str
    viewers: list[PageViewer]
    ended: bool = False


class CalibrationTool(Tool):
    """See the module's docstring.

    Args:
        file: the settings file, beside which the camera file is saved; None if there is none.
        flying: whether the vehicle flies now.
        armed: whether its motors are armed, as far as it says so.
    """

    kinds = (CalibrationRequest,)

    def __init__(
        self, pilot: Pilot, clock: Clock, file: SettingsFile | None, flying: Callable[[], bool], armed: Callable[[], bool]
    ) -> None:
        self._pilot = pilot
        self._clock = clock
        self._file = file
        self._flying = flying
        self._armed = armed
        self._run: _Run | None = None
        self._frames: Latest[NDArray[np.uint8]] = Latest()
        self._offered: MonoNs | None = None

    def ask(self, viewer: PageViewer, request: ToolRequest) -> None:
        assert isinstance(request, CalibrationRequest)
        if request.action == "begin":
            viewer.tell(self._begin(viewer, request))
        elif request.action == "end":
            self._end("ended")
        else:
            viewer.tell(self._saved())

    def on_frame(self, processed: ProcessedFrame) -> None:
        now = self._clock.now()
        if self._run is None or self._run.ended:
            return
        if self._offered is None or seconds_between(self._offered, now) >= _FRAME_S:
            self._offered = now
            self._frames.offer(processed.frame.px)

    async def run(self) -> None:
        with closing(Worker("page calibration")) as worker:
            async for px in self._frames:
                run = self._run
                if run is None or run.ended:
                    continue
                if self._flying():
                    self._end(TOOK_OFF)
                    continue
                try:
                    state = await worker.run(run.guide.add, f"frame {run.guide.state.images}", px)
                except BadInput as why:
                    self._end(str(why))
                    continue
                if not run.ended:
                    run.ended = state.complete
                    self._tell(run, "complete" if run.ended else "")

    def _begin(self, viewer: PageViewer, request: CalibrationRequest) -> CalibrationReport:
        if self._flying():
            return CalibrationReport(active=False, text=NO_CALIBRATION_IN_FLIGHT)
        if self._run is not None and not self._run.ended:
            if viewer not in self._run.viewers:
                self._run.viewers.append(viewer)
            return self._report(self._run, "a calibration is under way already; this is it")
        try:
            square_m = request.square_mm / 1000.0
            board = Board(request.board, request.columns, request.rows, square_m, _MARKER * square_m)
        except BadInput as why:
            return CalibrationReport(active=False, text=str(why))
        words = f"{request.board} {request.columns}x{request.rows}"
        self._run = _Run(Guide(board, self._pilot.camera.T_body_cam), words, [viewer])
        return self._report(self._run, "")

    def _end(self, why: str) -> None:
        if self._run is not None and not self._run.ended:
            self._run.ended = True
            self._tell(self._run, why)

    def _tell(self, run: _Run, words: str) -> None:
        report = self._report(run, words)
        for viewer in run.viewers:
            viewer.tell(report)

    def _report(self, run: _Run, words: str) -> CalibrationReport:
        state: GuideState = run.guide.state
        return CalibrationReport(
            active=not run.ended,
            text=words,
            images=state.images,
            views=state.views,
            board_seen=state.board_seen,
            cells=state.cells,
            lacks=state.lacks,
            rms_px=None if state.rms_px is None else round(state.rms_px, 3),
            grade=state.grade,
            file=self._text(run) if run.ended else "",
        )

    def _text(self, run: _Run) -> str:
        """Return the camera file; empty if the views do not give one that can be used."""
        solution = run.guide.solution
        if solution is None or run.guide.state.grade in (None, "poor"):
            return ""
        roll, pitch, yaw = (math.degrees(angle) for angle in self._pilot.camera.T_body_cam.R.rpy_rad)
        return text(solution, f"the operator page ({run.board}, {run.guide.state.grade})", (roll, pitch, yaw))

    def _saved(self) -> CalibrationReport:
        run = self._run
        if run is None or not run.ended:
            return CalibrationReport(active=run is not None, text="not saved: there is no finished calibration")
        try:
            return self._report(run, self._save(self._text(run)))
        except DecklanderError as why:
            return self._report(run, f"not saved: {why}")

    def _save(self, content: str) -> str:
        """Write the camera file beside the settings and return what follows.

        Raises:
            BadInput: it must not be written now or at all; the text gives the reason.
        """
        if self._flying() or self._armed():
            raise BadInput(NO_CALIBRATION_IN_FLIGHT if self._flying() else ARMED)
        if self._file is None:
            raise BadInput(NO_FILE)
        if not content:
            raise BadInput("the views give no camera that can be used")
        Camera.from_mapping(tomllib.loads(content), NAME)
        self._file.save_beside(NAME, content)
        return f'saved beside the settings: set camera.file = "{NAME}" there, and start the service again'


IN_FLIGHT = "the vehicle flies: the setup is examined on the ground; health says what is wrong now"
EXAMINATION_ENDED = "the vehicle took off, which ends the examination"
_AGAIN_S = 5.0
"""A younger diagnosis is used again."""
LISTENING_S = 4.0
"""Time for which messages are counted."""
_LOOKS_S = 0.1


class DoctorTool(Tool):
    """Examines the setup from inside the running service: over the links that it has open, on the ground alone.

    The links of a service cannot be opened twice, and requests to the autopilot share them with the flight. An examination
    therefore needs a vehicle that stands, and a take-off ends it at once.

    Args:
        autopilot: returns the autopilot whose links are open; None while they are not.
        flying: whether the vehicle flies now.
    """

    kinds = (ExamineRequest,)

    def __init__(
        self,
        settings: Settings,
        health: Health,
        clock: Clock,
        autopilot: Callable[[], Autopilot | None],
        flying: Callable[[], bool],
    ) -> None:
        self._settings = settings
        self._health = health
        self._clock = clock
        self._autopilot = autopilot
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

    async def run(self) -> None:
        while True:
            await self._asked.wait()
            async with asyncio.TaskGroup() as group:
                examining = group.create_task(self._examined())
                while not examining.done() and not self._flying():
                    await asyncio.wait([examining], timeout=_LOOKS_S)
                examining.cancel()
            report = ExaminedReport(text=EXAMINATION_ENDED) if examining.cancelled() else examining.result()
            if not examining.cancelled():
                self._newest = self._clock.now(), report
            self._asked.clear()
            waiting, self._waiting = self._waiting, []
            for viewer in waiting:
                viewer.tell(report)

    async def _examined(self) -> ExaminedReport:
        """Examine the setup, which takes some seconds."""
        snapshot = Snapshot(0.0)
        autopilot, vehicle = self._autopilot(), self._settings.vehicle
        if autopilot is not None and isinstance(vehicle, AutopilotOptions):
            from companion.tools.doctor.gather import examine_open

            snapshot = await examine_open(autopilot, vehicle.system_id, self._clock, LISTENING_S)
        elif isinstance(vehicle, AutopilotOptions):
            part = self._health.snapshot().parts.get("vehicle")
            why = "" if part is None else part.last_error
            snapshot = Snapshot(0.0, (LinkSnapshot(vehicle.links, down=why or "is not open yet"),))
        with closing(Worker("doctor")) as worker:
            return await worker.run(_report, snapshot, self._settings, self._health.snapshot())


def _report(snapshot: Snapshot, settings: Settings, health: HealthSnapshot) -> ExaminedReport:
    # The dialect is large, and a service without an autopilot does not need it before the first request.
    from companion.tools.doctor.diagnose import RULES, diagnose
    from companion.tools.doctor.gather_service import running_service

    findings = diagnose(structs.replace(snapshot, service=running_service(settings, health)))
    counted = f"{len(findings)} of {len(RULES)}" if findings else f"none of {len(RULES)}"
    return ExaminedReport(
        text=f"{counted} known faults found. {_about(snapshot)}",
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


def make_page(
    server: HttpServer,
    settings: Settings,
    pilot: Pilot,
    health: Health,
    clock: Clock,
    vehicle: str,
    autopilot: Callable[[], Autopilot | None],
    settings_file: Path | None = None,
) -> PageEndpoint:
    """Return the page of a server.

    Args:
        vehicle: the vehicle's name for the page.
        autopilot: returns the autopilot whose links are open; None while they are not.
        settings_file: the file that the settings were read from; None if there is none.
    """

    def in_flight() -> bool:
        return flying(pilot)

    def armed() -> bool:
        found = autopilot()
        return found is not None and found.condition.armed is True

    file = None if settings_file is None else SettingsFile(settings_file)
    folder, counts = Path(settings.recorder.folder), Counter[str]()
    tools = (
        DoctorTool(settings, health, clock, autopilot, in_flight),
        SettingsTool(settings, file, in_flight, armed),
        CalibrationTool(pilot, clock, file, in_flight, armed),
        Recordings(server, folder, clock, in_flight, counts),
        ReportMaker(server, folder, in_flight, counts),
    )
    return PageEndpoint(server, pilot, health, clock, vehicle, counts, tools)
