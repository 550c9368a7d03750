"""The innovations in the report: a plot for each source of each path, and the counts of verdicts behind their table."""

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from companion.tools.report.flight_log import FlightLog
from estimator.contracts.estimates import PathName, Verdict
from estimator.contracts.fusion import COMPONENTS, POSE_COMPONENTS, FusionResult, Source
from estimator.contracts.geometry import F64
from estimator.contracts.time import seconds_between


@dataclass(frozen=True, slots=True, eq=False)
class InnovationSeries:
    """The results of one source on one path over time."""

    path: PathName
    source: Source
    verdicts: Counter[Verdict]
    """The counts of verdicts on all measurements, including those that were compared with nothing."""
    components: tuple[str, ...]
    t_s: F64
    """The (n,) times since the flight's start of the measurements that were compared with a prediction, s."""
    innovation: F64
    """The (n, m) innovations; nan where a measurement lacked the component."""
    sigma: F64
    """The (n, m) standard deviations of the innovations that the filter claimed."""
    normalized_nis: F64
    """The (n,) values of NIS divided by the number of components."""
    test_ratio: F64
    """The (n,) test ratios."""
    fused: np.ndarray[tuple[int], np.dtype[np.bool_]]
    """The (n,) flags of whether each measurement was fused."""

    @property
    def name(self) -> str:
        """The path and the source, in words."""
        return f"{self.path}: {self.source}".replace("_", " ")

    @property
    def nis_mean(self) -> float:
        """Mean of NIS over the number of components of what was fused; nan without any."""
        values = self.normalized_nis[self.fused]
        return float(np.mean(values)) if len(values) else math.nan

    @property
    def test_ratio_p95(self) -> float:
        """95 % quantile of the test ratio of everything compared; nan without any."""
        return float(np.quantile(self.test_ratio, 0.95)) if len(self.test_ratio) else math.nan


def innovation_series(log: FlightLog) -> list[InnovationSeries]:
    """Return a series for each path and source that the log holds results of, sightings first, in the order of the paths."""
    grouped: dict[tuple[PathName, Source], list[FusionResult]] = {}
    for result in log.results:
        grouped.setdefault((result.path, result.source), []).append(result)
    paths = list(dict.fromkeys(path for path, _ in grouped))
    order = ["sighting", *COMPONENTS]
    return [_series(log, *key, grouped[key]) for key in sorted(grouped, key=lambda k: (paths.index(k[0]), order.index(k[1])))]


def _series(log: FlightLog, path: PathName, source: Source, results: list[FusionResult]) -> InnovationSeries:
    compared = sorted((r for r in results if math.isfinite(r.nis)), key=lambda r: r.measured_at)
    met = {name for r in compared for name in r.components}
    known = dict.fromkeys((*COMPONENTS[source], *(POSE_COMPONENTS if source == "sighting" else ())))
    components = tuple(name for name in known if name in met)
    column = {name: i for i, name in enumerate(components)}
    innovation = np.full((len(compared), len(components)), np.nan)
    sigma = innovation.copy()
    for i, r in enumerate(compared):
        assert r.innovation is not None
        assert r.innovation_cov is not None
        where = [column[name] for name in r.components]
        innovation[i, where] = r.innovation
        sigma[i, where] = np.sqrt(np.diag(r.innovation_cov))
    return InnovationSeries(
        path,
        source,
        Counter(r.verdict for r in results),
        components,
        np.array([seconds_between(log.started, r.measured_at) for r in compared]),
        innovation,
        sigma,
        np.array([r.normalized_nis for r in compared]),
        np.array([r.test_ratio for r in compared]),
        np.array([r.verdict is Verdict.FUSED for r in compared], dtype=bool),
    )
