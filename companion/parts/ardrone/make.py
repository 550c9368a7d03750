"""The service's vehicle if that is an AR.Drone: its link."""

from functools import partial

from companion.cycle.ports import Assembly, VehicleParts
from drivers.ardrone.link import open_ardrone
from drivers.ardrone.options import ardrone_options
from estimator.uvlc import UvlcDecoder


def make_vehicle(service: Assembly) -> VehicleParts:
    """Return the AR.Drone of the settings."""
    options = ardrone_options(service.settings.vehicle)
    return VehicleParts(partial(open_ardrone, options, service.clock, UvlcDecoder(), service.health.failed))
