"""Mutation tests of what decides: filter, gates, guidance and the command streamers. `make mutants`; see docs/extending.md."""
