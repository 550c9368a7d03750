"""The words of the service, which all that works knows: states, orders, observers, health, supervision, containment."""
