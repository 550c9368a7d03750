"""The service: lifetimes, guidance, links, recorder, command line."""
