"""The rules of tests/conftest.py hold here too."""

from tests.conftest import out_of_the_collectors_sight, pytest_configure

__all__ = ["out_of_the_collectors_sight", "pytest_configure"]
