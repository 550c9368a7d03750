"""Make the page with its tools from the settings of a service: the guided calibration and the doctor among them."""

from companion.parts.page.calibration_tool import CalibrationTool
from companion.parts.page.doctor_tool import DoctorTool
from companion.parts.page.endpoint import PageEndpoint
from companion.parts.page.recordings import Recordings
from companion.parts.page.settings_tool import SettingsTool
from companion.parts.page.viewer import PageService


def make_page(service: PageService, vehicle: str) -> PageEndpoint:
    """Return the page with its tools.

    Args:
        vehicle: the vehicle's name for the page.
    """
    return PageEndpoint(service, vehicle, [tool(service) for tool in (DoctorTool, SettingsTool, CalibrationTool, Recordings)])
