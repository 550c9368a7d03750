"""Install the service on a computer with systemd: versions side by side, one link to the current one, files of the system.

The standard library and the tree of errors only: a package's maintainer scripts run this out of the wheel, before there is any
environment.
"""
