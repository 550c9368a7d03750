"""The page's tools that work on the ground alone, and are loaded when a browser first wants one there."""

import asyncio
from collections.abc import Mapping
from typing import NamedTuple

from companion.base.observer import ProcessedFrame
from companion.parts.page.messages import CalibrationReport, CalibrationRequest, ExaminedReport, ExamineRequest, ToolRequest
from companion.parts.page.viewer import PageService, PageViewer, Tool
from drivers.mailbox import Line
from estimator.contracts.tables import imported

NO_EXAMINATION_IN_FLIGHT = "the vehicle flies: the setup is examined on the ground; health says what is wrong now"
NO_CALIBRATION_IN_FLIGHT = "the vehicle flies: the camera is calibrated on the ground"
_WAITING = 8  # requests that may wait


class GroundTool(NamedTuple):
    """The name of a tool, and its answer in flight."""

    tool: str
    """A `Tool` of a `PageService`, as module:object."""
    in_flight: ExaminedReport | CalibrationReport


TOOLS: Mapping[type, GroundTool] = {
    ExamineRequest: GroundTool("companion.parts.page.doctor_tool:DoctorTool", ExaminedReport(text=NO_EXAMINATION_IN_FLIGHT)),
    CalibrationRequest: GroundTool(
        "companion.parts.page.calibration_tool:CalibrationTool", CalibrationReport(active=False, text=NO_CALIBRATION_IN_FLIGHT)
    ),
}
"""The tools by the kind of request."""


class LoadedTool(Tool):
    """Stands for a tool, and loads it on a thread with the first request that comes on the ground.

    A flight thus neither keeps the tool's modules in memory nor waits for them.
    """

    def __init__(self, service: PageService, kind: type) -> None:
        self.kinds = (kind,)
        self._service, self._named = service, TOOLS[kind]
        self._tool: Tool | None = None
        self._waiting: Line[tuple[PageViewer, ToolRequest]] = Line(_WAITING)

    def ask(self, viewer: PageViewer, request: ToolRequest) -> None:
        if self._tool is not None:
            self._tool.ask(viewer, request)
        elif self._service.flying:
            viewer.tell(self._named.in_flight)
        else:
            self._waiting.offer((viewer, request))

    def on_frame(self, processed: ProcessedFrame) -> None:
        if self._tool is not None:
            self._tool.on_frame(processed)

    async def run(self) -> None:
        first = await self._waiting.get()
        self._tool = tool = (await asyncio.to_thread(imported, self._named.tool))(self._service)
        for viewer, request in (first, *self._waiting.waiting()):
            tool.ask(viewer, request)
        await tool.run()
