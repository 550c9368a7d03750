"""Run a calibration from the page: count what a flight gives, and write the file that is found."""

import tomllib
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.base.observer import ProcessedFrame
from companion.base.worker import Worker
from companion.parts.page.ground_tools import NO_CALIBRATION_IN_FLIGHT
from companion.parts.page.messages import CalibrationReport, CalibrationRequest, ToolRequest
from companion.parts.page.settings_tool import ARMED, NO_FILE
from companion.parts.page.viewer import PageService, PageViewer, Tool
from companion.tools.calibrate.board import Board
from companion.tools.calibrate.camera_file import text
from companion.tools.calibrate.guide import Guide, GuideState
from drivers.mailbox import Latest
from estimator.contracts.errors import BadInput, DecklanderError
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.camera.camera import Camera

TOOK_OFF = "the vehicle took off, which ends the calibration"
NAME = "camera_calibrated.toml"
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
    """Guides a calibration of the camera; its file is saved beside the settings."""

    kinds = (CalibrationRequest,)

    def __init__(self, service: PageService) -> None:
        self._service = service
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
        now = self._service.clock.now()
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
                if self._service.flying:
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
        if self._service.flying:
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
        self._run = _Run(Guide(board, self._service.pilot.camera.T_body_cam), words, [viewer])
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
        roll, pitch, yaw = np.degrees(self._service.pilot.camera.T_body_cam.R.rpy_rad).tolist()
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
        if self._service.flying or self._service.armed:
            raise BadInput(NO_CALIBRATION_IN_FLIGHT if self._service.flying else ARMED)
        if self._service.settings_file is None:
            raise BadInput(NO_FILE)
        if not content:
            raise BadInput("the views give no camera that can be used")
        Camera.from_mapping(tomllib.loads(content), NAME)
        self._service.settings_file.save_beside(NAME, content)
        return f'saved beside the settings: set camera.file = "{NAME}" there, and start the service again'
