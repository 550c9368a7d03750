"""Tools that the page offers beside the flight: each answers requests of browsers, and does its own work."""

from typing import Protocol

from companion.base.observer import ProcessedFrame
from companion.guidance.pilot import Pilot
from companion.parts.page.tool_messages import ToolRequest
from companion.parts.page.viewer import PageViewer


class Tool(Protocol):
    """One tool. It must not disturb a flight: work that takes time or the link is done only on the ground."""

    kinds: tuple[type, ...]
    """The requests that it answers."""

    def ask(self, viewer: PageViewer, request: ToolRequest) -> None:
        """Take a request and return at once; the answer goes to the viewer, now or later."""

    def on_frame(self, processed: ProcessedFrame) -> None:
        """Look at a frame; it must be quick."""

    async def run(self) -> None:
        """Work until cancelled."""


def flying(pilot: Pilot) -> bool:
    """Return whether the vehicle reports that it flies."""
    status = pilot.vehicle
    return status is not None and bool(status.flying)
