"""Build of the native core and of the releases: wheels, a Debian package, licences, known weaknesses."""
