"""Moving-baseline RTK."""
