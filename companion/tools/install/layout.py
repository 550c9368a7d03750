"""Where an installation has its files, as the installed computer names them."""

from __future__ import annotations

PREFIX = "/opt/decklander"
CURRENT = f"{PREFIX}/current"
"""The link to the version that runs."""
PREVIOUS = f"{PREFIX}/previous"
"""The link to the version before it, to which `rollback` returns."""
LOCK = f"{PREFIX}/.lock"
COMPLETE = "complete.json"
"""The file of a version's folder that is written last: without it the version counts as unfinished."""
SHARE = "share/decklander"
"""The folder of a version with the files of the system that belong to it."""

UNIT_NAME = "decklander.service"
UNIT = f"/etc/systemd/system/{UNIT_NAME}"
WANTED = f"/etc/systemd/system/multi-user.target.wants/{UNIT_NAME}"
"""The link that starts the service with the computer."""
UDEV = "/etc/udev/rules.d/70-decklander.rules"
SYSUSERS = "/etc/sysusers.d/decklander.conf"
SYSTEM_FILES = {UNIT_NAME: UNIT, "70-decklander.rules": UDEV, "decklander.sysusers.conf": SYSUSERS}
"""The files of the system by their names in `configs/systemd`."""
PACKAGED_UNIT = f"/lib/systemd/system/{UNIT_NAME}"
"""The unit where a Debian package owns the system's files."""
COMMAND = "/usr/local/bin/decklander"

SETTINGS_FOLDER = "/etc/decklander"
SETTINGS = f"{SETTINGS_FOLDER}/rig.toml"
CREDENTIALS = "/etc/credstore"
CREDENTIAL_PREFIX = "decklander."
DROP_IN = f"{UNIT}.d"
DATA = ("/var/lib/decklander", "/var/lib/private/decklander", "/var/cache/decklander", "/var/cache/private/decklander")
"""Recordings, waiting events and caches; systemd keeps them below `private`, with a link beside it."""
USER = "decklander"
