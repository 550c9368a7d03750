"""Whole flights in virtual time: the same to the bit for a seed, onto the pad, and never lower for a fault."""

import hashlib
from functools import cache

import msgspec
import numpy as np
import pytest

from companion.base.mission import FlightOutcome, State
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.guidance.make_pilot import make_pilot
from companion.settings.load import load
from estimator.contracts.commands import Land, Lean, Velocity
from estimator.contracts.estimates import Verdict
from sitl.faults.kinds import KINDS, STREAMS
from sitl.flight.flight import Flight
from sitl.flight.grader import FlightResult
from sitl.perception.levels import perceive
from sitl.scenario.scenario import Scenario
from sitl.scenario.scenario import load as load_scenario

SIM = load("sim")
CALM = load_scenario("calm")
LOW = msgspec.structs.replace(
    CALM, start=msgspec.structs.replace(CALM.start, height_m=2.2, pad_forward_m=0.3, pad_right_m=0.2), duration_limit_s=40.0
)
"""A short flight: most of it is the descent."""
_ON_DECK = (State.PRESS.value, State.DOWN.value)
"""Phases that only a felt contact leads to."""


class Diary(NullObserver):
    """All decisions, their digest, and whether sight was fresh at each."""

    def __init__(self) -> None:
        self.decisions: list[Decision] = []
        self.verdicts: list[Verdict] = []
        self.errors_m: list[float] = []
        """Distance of the estimate from the truth at each decision that had one."""
        self.flight: Flight | None = None
        self._digest = hashlib.sha256()

    def on_frame(self, processed: ProcessedFrame) -> None:
        self.verdicts.append(processed.verdict)
        self._digest.update(processed.frame.px.tobytes())

    def on_decision(self, decision: Decision) -> None:
        self.decisions.append(decision)
        if decision.belief is not None:
            self._digest.update(decision.belief.d_body_pad_level.tobytes() + decision.belief.cov.tobytes())
            true = self.flight.world.truth().d_body_pad_level
            self.errors_m.append(float(np.linalg.norm(decision.belief.d_body_pad_level - true)))
        if isinstance(decision.command, Velocity | Lean):
            self._digest.update(decision.command.v_level.tobytes())

    @property
    def digest(self) -> str:
        return self._digest.hexdigest()


def fly_low(scenario: Scenario, seed: int, limit_s: float | None = None) -> tuple[FlightResult, Diary, Flight]:
    if limit_s is not None:
        scenario = msgspec.structs.replace(scenario, duration_limit_s=limit_s)
    diary = Diary()
    diary.flight = flight = Flight(scenario, seed, SIM, make_pilot(SIM, shadows=("median_mean",)), observers=[diary])
    return flight.run(), diary, flight


@pytest.mark.parametrize("frames_per_s", [15, 30])
def test_frames_come_as_often_as_the_drone_is_configured_to_send_them(frames_per_s: int) -> None:
    vehicle = msgspec.structs.replace(SIM.vehicle, further_configuration=f"video:codec_fps={frames_per_s}")
    settings = msgspec.structs.replace(SIM, vehicle=vehicle)
    level = perceive("truth", None)
    flight = Flight(LOW, 3, settings, level.pilot(settings), perception=level)
    while flight.world.now < flight.world.started + 2_000_000_000:
        flight.step()
    assert flight.exposures == pytest.approx(2 * frames_per_s, abs=1)


@cache
def calm() -> tuple[FlightResult, Diary]:
    result, diary, _ = fly_low(LOW, 3)
    return result, diary


def with_fault(kind: str, start_s: float, duration_s: float) -> Scenario:
    effect = {"dropped_fraction": 1.0} if kind in STREAMS else {}
    return msgspec.structs.replace(LOW, faults=(KINDS[kind](at_s=start_s, for_s=duration_s, **effect),))


def test_it_lands_on_the_pad_and_every_frame_is_counted() -> None:
    result, diary = calm()
    assert result.outcome is FlightOutcome.LANDED
    assert result.landed_on_pad
    assert result.truth.touchdown is not None
    assert result.truth.touchdown.lateral_m < 0.25
    assert result.truth.touchdown.vertical_speed_m_s < 0.8
    assert result.health.frames.total() == len(diary.verdicts)
    assert result.health.frames[Verdict.FUSED] > 0.6 * result.health.frames.total()


def test_a_seed_is_a_flight_to_the_bit_and_another_seed_another() -> None:
    one, again, other = (fly_low(LOW, seed, limit_s=2.0)[1].digest for seed in (3, 3, 4))
    assert one == again
    assert one != other


def decisions_blind(diary: Diary) -> int:
    """Return at how many decisions sight was stale, none of which descends; what the air does to the drone is not a command."""
    blind = 0
    for decision in diary.decisions:
        belief = decision.belief
        fresh = belief is not None and belief.age_s(decision.at) <= SIM.guidance.stale_after_s
        if not fresh and decision.phase not in _ON_DECK:
            blind += 1
            assert not (isinstance(decision.command, Velocity | Lean) and decision.command.v_level[2] > 0), decision
            assert not isinstance(decision.command, Land), decision
    return blind


@pytest.mark.parametrize("kind", ["frames", "navdata"])
def test_a_fault_in_the_descent_never_makes_it_descend_or_land_without_sight(kind: str) -> None:
    """Losses of the wires are lost with images and without: the flight sees by the model of them."""
    diary, perception = Diary(), perceive("model")
    scenario = msgspec.structs.replace(with_fault(kind, 2.5, 4.0), duration_limit_s=12.0)
    pilot = perception.pilot(SIM)
    diary.flight = flight = Flight(scenario, 3, SIM, pilot, observers=[diary], perception=perception)
    flight.run()
    assert decisions_blind(diary) > 50
    truth = flight.world.truth()
    assert truth.touchdown is None or truth.touchdown.surface in ("pad", "deck")


def test_it_lands_after_the_lens_was_covered_for_a_while_in_which_it_never_sank_nor_began_to_land() -> None:
    result, diary, _ = fly_low(with_fault("lens_covered", 2.5, 3.0), 3)
    assert decisions_blind(diary) > 50
    assert result.landed_on_pad
    phases = {d.phase for d in diary.decisions}
    assert "go around" in phases
