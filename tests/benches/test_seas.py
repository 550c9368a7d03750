"""The witness of seas: shapes of spectra that are known, and a recorded ship under the filter for some seconds."""

import numpy as np
import pytest

from benches.witness import seas
from sitl.sea.sea import SeaState
from sitl.vessel.file import RecordedMotion
from tests.support.pad_scenes import DATA

PALMER = DATA / "ship_palmer/s330.txt"


def test_the_shape_of_a_fully_grown_sea_is_that_of_its_formula() -> None:
    """Bretschneider's spectrum has Tm02 = .7104 Tp and Goda's Qp = 2; a narrow one has long groups."""
    hz = np.linspace(0.01, 20.0, 200_000)
    shape = seas.Spectrum.of(hz, 2.0 * np.pi * SeaState(2.0, 8.0, 1.0).density(2.0 * np.pi * hz))
    assert (shape.hs, shape.tp, shape.tm02, shape.qp) == pytest.approx((2.0, 8.0, 0.7104 * 8.0, 2.0), rel=0.01)
    narrow = seas.Spectrum.of(hz, np.exp(-0.5 * ((hz - 0.1) / 0.004) ** 2))
    assert (narrow.nu, narrow.run > 3.0 * shape.run) == (pytest.approx(0.04, rel=0.01), True)


@pytest.mark.skipif(not PALMER.exists(), reason=f"{PALMER} is not here")
def test_a_recorded_ships_deck_is_forecast_better_than_by_its_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seas, "FLIGHT_S", 24.0)
    deck = seas.recorded("Palmer", RecordedMotion.of_file(PALMER, 0.0), "research_vessel")._replace(flights=1)
    assert "104 cm, 10." in seas.motion_row(deck)
    assert all(0.0 < float(cell.split()[1]) < 0.9 for cell in seas.forecast_row(deck).split(" | ")[2:])
