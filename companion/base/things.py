"""State where things lie on the pad, and about it, for those who watch."""

import math

from msgspec import Struct

from estimator.vision.detection import Detection


class ThingReport(Struct, frozen=True, kw_only=True):
    """Something on the pad or about it. Axes of the pad: x along the arrow, y to starboard of it."""

    x_m: float
    y_m: float
    width_m: float | None = None
    """Its larger extent, if it lies on the pad."""
    height_m: float | None = None
    """Height that it stands out of the deck, if it is about the pad; 0 for what moves."""

    @property
    def words(self) -> str:
        """Text on what it does where, in one line."""
        if self.width_m is not None:
            how = f"{100.0 * self.width_m:.0f} cm wide lies on the pad"
        else:
            how = f"stands {100.0 * self.height_m:.0f} cm out of the deck" if self.height_m else "moves about the pad"
        return f"something {how}, {math.hypot(self.x_m, self.y_m):.2f} m from its centre"


def things_of(detection: Detection | None) -> tuple[ThingReport, ...]:
    """Return what a frame's detection knows of things on the pad and about it."""
    check = None if detection is None else detection.on_pad
    if check is None:
        return ()
    lies, near = check.thing, check.near
    on_it = () if lies is None else (ThingReport(x_m=lies.forward_m, y_m=lies.right_m, width_m=lies.width_m),)
    return on_it if near is None else (*on_it, ThingReport(x_m=near.forward_m, y_m=near.right_m, height_m=near.height_m))
