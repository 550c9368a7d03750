"""The links of a table of the settings file, with the key and the kept times that they are signed with."""

import logging
import os
from collections.abc import Mapping
from pathlib import Path

from companion.settings.files import Renewed, signing_key
from drivers.mavlink.links import LinkOptions
from drivers.mavlink.options import MavlinkOptions
from drivers.mavlink.signing import Signing, SigningTimes

_log = logging.getLogger(__name__)


def signed_links(options: MavlinkOptions, environment: Mapping[str, str] | None = None) -> tuple[LinkOptions, ...]:
    """Return the links of the options; where they are signed, each has a link id of its own.

    Raises:
        BadInput: a key that cannot be read.
    """
    found = options.endpoints()
    if not options.signing_key_file:
        level = logging.INFO if all(endpoint.is_private for endpoint in found) else logging.WARNING
        if found:
            _log.log(level, "MAVLink over %s is %s", options.links, options.unsigned)
        return tuple(LinkOptions(endpoint, limits=options) for endpoint in found)
    environment = os.environ if environment is None else environment
    named = options.signing_key_file
    key = Renewed(lambda: signing_key(named, environment=environment), "signing key", named, environment=environment)
    file = _time_file(options.signing_time_file, environment)
    if file is None:
        _log.warning(
            "signing times are kept in memory alone: after a restart, messages up to a minute old could be played again; "
            "set signing_time_file, or let systemd give a StateDirectory"
        )
    times = SigningTimes(file)
    return tuple(LinkOptions(endpoint, Signing(key, times, number), options) for number, endpoint in enumerate(found))


def _time_file(named: str, environment: Mapping[str, str]) -> Path | None:
    if named:
        return Path(named)
    state = environment.get("STATE_DIRECTORY")
    return Path(state) / "mavlink-signing-time" if state else None
