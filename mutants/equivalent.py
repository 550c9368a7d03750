"""Mutants that no test can tell from the original, file by file, with the reason.

A change is written as `python -m mutants` prints it. A run counts these apart, and says so when a test kills one of them.
"""

from __future__ import annotations

EQUIVALENT: dict[str, dict[str, str]] = {}
