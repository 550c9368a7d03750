"""Mutants that no test can tell from the original, file by file, with the reason.

A change is written as `python -m mutants` prints it. A run counts these apart, and says so when a test kills one of them.
"""

from __future__ import annotations

_ROUNDED = "computed real numbers: where they are equal to the last bit either decision is as good"

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
        "if (missing[axis] <= 0.0) {  ->  if (missing[axis] < 0.0) {": "a variance of zero adds nothing",
    },
    "estimator/core/vision.c": {
        "const int lost = sqrt(fmax(var / 3.0, 0.0)) > LOST_SIGMA_M;"
        "  ->  const int lost = sqrt(fmax(var / 3.0, 0.0)) >= LOST_SIGMA_M;": _ROUNDED,
        "if (row->ok && (turned_round || (row->m > 3 && row->nis <= o->nis_max[row->m - 1]))) {"
        "  ->  if (row->ok && (turned_round || (row->m > 3 && row->nis < o->nis_max[row->m - 1]))) {": _ROUNDED,
        "if (row->nis > o->nis_max[dof - 1]) {  ->  if (row->nis >= o->nis_max[dof - 1]) {": _ROUNDED,
        "compare(o, b, c->P, s, 1, other);  ->  compare(o, b, c->P, s, 2, other);": "a flag that is asked for being zero",
    },
}
