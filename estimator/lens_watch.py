"""A second filter that finds a lens which is not where the camera's file has it in the body.

A lens elsewhere displaces the pad by the same vector of the body in every picture, and the landing by all of it. A turn carries
that vector round, a lean lifts and lowers it against the accelerometer, and unlike a tilted camera's error it does not shrink on
the way down. So a filter that estimates the lens' place beside all else tells it within an approach. It steers nothing:
vision, track and estimate would all have to begin again with another lens, and the file is a person's to mend.
"""

import math
from collections.abc import Sequence

from msgspec import structs

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.samples import Baseline, Sample
from estimator.options import EstimatorOptions
from estimator.paths import EkfPath

_MOUNT_RAD = 0.1  # Standard deviation of the camera's orientation: a camera that is knocked aside by degrees is no lens elsewhere
_SURE = 4.0  # Standard deviations by which the error has to be beyond the tolerance


class LensWatch:
    """A filter that estimates the place of the lens from what the steering one is given.

    Args:
        options: those of the estimator.

    Attributes:
        off_m: the error of the lens' place by the newest sighting, true minus the file's, forward and right, m.
        sigma_m: its standard deviation along itself, m.
    """

    def __init__(self, options: EstimatorOptions) -> None:
        own = structs.replace(options.ekf, sigma_lever_m=options.integrity.lens_sigma_m, sigma_mount_rad=_MOUNT_RAD)
        self._path, self._tolerance_m = EkfPath(own), options.integrity.lens_tolerance_m
        self.off_m: tuple[float, float] = (0.0, 0.0)
        self.sigma_m: float = own.sigma_lever_m
        self._sure = False

    def put(self, samples: Sequence[Sample | Baseline]) -> None:
        """Take samples in the order in which they were received."""
        self._path.put(samples, wanted=False)

    def sight(self, sighting: Sighting) -> None:
        """Take a sighting that the guard let pass."""
        fused, at = self._path.sight(sighting).verdict is Verdict.FUSED, sighting.stamp.measured_at
        answer = self._path.answer(at) if fused else None
        if answer is None or answer.pad is None:
            return
        off, sigma = answer.lens
        (forward, right, _), (ahead, aside, _) = off.tolist(), sigma.tolist()
        far_m = math.hypot(forward, right)
        self.off_m = forward, right
        self.sigma_m = math.hypot(forward * ahead, right * aside) / far_m if far_m > 0.0 else max(ahead, aside)
        self._sure = answer.pad.consistent and far_m - self._tolerance_m > _SURE * self.sigma_m

    @property
    def misplaced_m(self) -> tuple[float, float] | None:
        """`off_m` where it is surely beyond the tolerance, else None."""
        return self.off_m if self._sure else None
