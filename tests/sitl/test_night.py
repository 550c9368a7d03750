"""A landing on a dark deck by the pad's own lamps, pixels and wires in the loop."""

from collections import Counter

from companion.base.observer import NullObserver, ProcessedFrame
from tests.fly import land


class Chosen(NullObserver):
    """Counts by what the pad was seen."""

    def __init__(self) -> None:
        self.by: Counter[str | None] = Counter()

    def on_frame(self, processed: ProcessedFrame) -> None:
        if processed.detection is not None:
            self.by[processed.detection.chosen] += 1


def test_a_vehicle_lands_at_night_by_the_lamps_of_the_pad():
    chosen = Chosen()

    ending = land("night", 300, level="pixels", observers=[chosen]).as_json()

    assert ending["landed_on_pad"], ending
    assert ending["touchdown"]["lateral_m"] < 0.1
    assert ending["contacts_outside_commit"] == 0
    assert chosen.by["lamps"] > 100
    # Near the deck the lamps leave the picture, once more with each try.
    assert chosen.by["registration"] < 0.2 * chosen.by["lamps"]
