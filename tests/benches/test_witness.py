"""The chaos bench, and rows of the tables in which the simulator stands beside the physics and the seas of others."""

import numpy as np
import pytest

from benches import real
from benches.chaos import Chaos, Event, Seen, as_toml, draw, judged, of_toml
from benches.witness import body, seas
from benches.witness.contact import CASES, Case, Ours, Theirs, agree, landing, of_friction
from sitl.sea.sea import SeaState
from sitl.vehicle.airframe import load
from sitl.vessel.file import RecordedMotion
from tests.support.pad_scenes import DATA

PALMER = DATA / "ship_palmer/s330.txt"


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_contact_is_as_in_mujoco(case: Case) -> None:
    pytest.importorskip("mujoco", reason="the extra witness is not installed")
    f = of_friction(0.4)
    assert agree(landing(Ours(f, case)), landing(Theirs(f, case)))


def test_the_vehicle_answers_and_is_braked_as_in_rotorpy() -> None:
    pytest.importorskip("rotorpy", reason="RotorPy is not installed (requirements/rotorpy.txt)")
    f = load(body.VEHICLE).airframe()
    ours, theirs = (body.tilt_step(kind(f), 10.0) | body.moving(kind(f), 5.0, 0.0) for kind in (body.Ours, body.Theirs))
    for name in ("10 to 90 %, ms", "drag, m/s^2"):
        assert ours[name] == pytest.approx(theirs[name], rel=0.2), name


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


def test_the_work_for_circles_takes_none_from_an_octagon_at_the_edge_of_the_frame() -> None:
    folder = real.needed("real_pads/octagon/images") if (DATA / "real_pads/octagon").exists() else pytest.skip("no octagons here")
    words = ("--sheet", "--corners", "184,97 357,118 371,350 144,338", "--size-mm", "210x297", "--paints", "2")
    pad, px = real.imported(folder / "samples_img_110.jpg", *words), real.image(folder / "test_image0002_1594965131.905431.jpg")
    assert real.lies_at_any(real.seen(px, real.OCTAGON, pad), real.octagons(px))


def chaos_flight(lines: tuple[tuple[float, str], ...] = (), hole: tuple[float, float] = (0.0, 0.0)) -> Seen:
    """Return a flight with a command each 0.04 s from instant 100 s on, for 20 s, apart from a hole, and heartbeats likewise."""
    commands = [100.0 + 0.04 * n for n in range(500)]
    beats = [100.0 + n for n in range(20)]
    out = Seen(lines=list(lines), began=100.0, code=0)
    out.commands, out.beats = ([t for t in ts if not hole[0] < t < hole[1]] for ts in (commands, beats))
    return out


def test_what_is_written_is_flown_again() -> None:
    flights = [draw(seed, None) for seed in range(10)]
    assert of_toml(as_toml([judged(chaos, chaos_flight()) for chaos in flights])) == flights


@pytest.mark.parametrize(("kind", "good"), [("cpu_hogs", False), ("link_stalls", True), ("service_stopped", True)])
def test_a_gap_counts_unless_it_is_the_links_own(kind: str, good: bool) -> None:
    chaos = Chaos(1, "mavlink", (Event(kind, 5.0, 4.0),))
    row = judged(chaos, chaos_flight(((106.0, "no status; it stood still"),), hole=(105.0, 109.0)))
    assert row.good == good
    assert (row.gap_s > 3.9) == (not good)
    assert (row.beats_missed > 0) == (not good)


def test_an_event_without_a_word_in_time_is_reported() -> None:
    chaos = Chaos(1, "mavlink", (Event("disk_full", 2.0, 1.0),))
    assert judged(chaos, chaos_flight(((104.0, "recorder: No space left on device"),))).good
    late = judged(chaos, chaos_flight(((114.0, "recorder: No space left on device"),)))
    assert late.unnamed == ("disk_full",)
    assert not late.good
    asleep = Chaos(1, "mavlink", (Event("disk_full", 2.0, 1.0), Event("service_stopped", 1.0, 3.0)))
    assert judged(asleep, chaos_flight(((104.0, "the service stood still"),))).good, "a stopped service meets no full disk"
