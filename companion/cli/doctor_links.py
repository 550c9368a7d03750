"""The links that `decklander doctor` is given: by `--link`, or by the settings file."""

from __future__ import annotations

import argparse

from msgspec.structs import replace

from companion.parts.mavlink.signed_links import signed_links
from companion.settings.load import Settings
from drivers.mavlink.links import LinkOptions
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.signing import Signing, load_key
from drivers.mavlink.signing_times import SigningTimes
from estimator.contracts.errors import BadInput

GivenLinks = tuple[AutopilotOptions, tuple[LinkOptions, ...]]


def given_links(args: argparse.Namespace, settings: Settings | None) -> GivenLinks | None:
    """Return the options and the links with their keys, as given or as the settings have them; None if there is no link.

    Raises:
        BadInput: a link, the system id or the key is wrong.
    """
    if args.system is not None and not 1 <= args.system <= 255:
        raise BadInput(f"--system must lie in 1 to 255, got {args.system}")
    if not args.link:
        vehicle = None if settings is None else settings.vehicle
        if not isinstance(vehicle, AutopilotOptions):
            return None
        return vehicle if args.system is None else replace(vehicle, system_id=args.system), signed_links(vehicle)
    try:
        options = AutopilotOptions(", ".join(args.link), system_id=args.system or 0)
    except ValueError as why:
        raise BadInput(str(why).replace("links:", "--link:", 1)) from why
    key = load_key(args.signing_key) if args.signing_key else None
    times = SigningTimes(None)
    return options, tuple(
        LinkOptions(endpoint, None if key is None else Signing(key, times, number))
        for number, endpoint in enumerate(options.endpoints())
    )
