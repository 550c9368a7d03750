"""Make the page with its tools from the settings of a service."""

from companion.cycle.ports import Assembly
from companion.parts.page.endpoint import PageEndpoint
from companion.parts.page.ground_tools import TOOLS, LoadedTool
from companion.parts.page.recordings import Recordings
from companion.parts.page.settings_tool import SettingsTool
from companion.parts.page.viewer import PageService
from companion.settings.settings_file import SettingsFile


def make_page(service: PageService, vehicle: str) -> PageEndpoint:
    """Return the page with its tools.

    Args:
        vehicle: the vehicle's name for the page.
    """
    tools = (SettingsTool(service), Recordings(service), *(LoadedTool(service, kind) for kind in TOOLS))
    return PageEndpoint(service, vehicle, tools)


def join(service: Assembly) -> None:
    """Serve the page on the HTTP port."""
    assert service.server is not None
    assert service.vehicle is not None
    settings, path = service.settings, service.settings_file
    file = None if path is None else SettingsFile(path)
    of_page = PageService(service.server, settings, service.pilot, service.health, service.clock, service.vehicle.autopilot, file)
    page = make_page(of_page, settings.vehicle.name)
    service.observers.append(page)
    service.extras["page"] = page.run
