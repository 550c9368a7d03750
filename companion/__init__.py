"""The service, in layers: settings < base < guidance < recording < tools < parts < service < cli."""
