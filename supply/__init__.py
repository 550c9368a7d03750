"""How the native core is built, and what is shipped: wheels, a Debian package, licences, known weaknesses."""
