"""Make the page with its tools from the settings of a service."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from companion.base.connection_limits import ConnectionLimits
from companion.base.health import Health
from companion.guidance.pilot import Pilot
from companion.parts.page.calibration_tool import CalibrationTool
from companion.parts.page.doctor_tool import DoctorTool
from companion.parts.page.endpoint import PageEndpoint
from companion.parts.page.settings_tool import SettingsTool
from companion.parts.page.tool import Tool, flying
from companion.settings.model import Settings
from companion.settings.settings_file import SettingsFile
from companion.tools.doctor.live import LiveExaminer
from estimator.contracts.ports import Clock

if TYPE_CHECKING:
    from drivers.mavlink.autopilot import Autopilot


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
