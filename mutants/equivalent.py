"""Mutants that no test can tell from the original, file by file, with the reason.

A change is written as `python -m mutants` prints it. A run counts these apart, and says so when a test kills one of them.
"""

from __future__ import annotations

_ROUNDED = "two rounded real numbers, which no input makes equal"

EQUIVALENT: dict[str, dict[str, str]] = {
    "estimator/core/gate.c": {
        "if (b->rejected_n == 0 || t < b->rejected_last || length(step) > limit || dt > PAUSE_S) {"
        "  ->  if (b->rejected_n == 0 || t < b->rejected_last || length(step) >= limit || dt > PAUSE_S) {": _ROUNDED,
    },
    "estimator/core/deck_jolt.c": {
        "if (fmax(ratio[0], fmax(ratio[1], ratio[2])) > RATIO_COUNTED) {"
        "  ->  if (fmax(ratio[0], fmax(ratio[1], ratio[2])) >= RATIO_COUNTED) {": _ROUNDED,
        "while (at > 0 && ordered[at - 1] > value) {  ->  while (at > 0 && ordered[at - 1] < value) {": (
            "the values sorted the other way have the same median"
        ),
        "while (at > 0 && ordered[at - 1] > value) {  ->  while (at > 0 && ordered[at - 1] >= value) {": (
            "equal values may change places"
        ),
    },
}
