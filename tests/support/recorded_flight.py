"""A short simulated flight for the tests of recorder and replay."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from companion.base.observer import Decision, NullObserver, Observer, ProcessedFrame
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.guidance.make_pilot import make_pilot
from companion.parts.recorder.recorder import Recorder
from companion.parts.recorder.setup import about, recorder_to_file
from companion.recording.records import TruthRecord
from companion.settings.load import Settings, load
from companion.settings.model import CameraSettings, PadSettings
from estimator.contracts.samples import Sample
from sitl.flight.flight import Flight
from sitl.scenario.scenario import load as load_scenario

SCENARIO = "demo"


class ObservedCalls(NullObserver):
    """Records every call that the observers received."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.frames: list[ProcessedFrame] = []
        self.decisions: list[Decision] = []

    def on_sample(self, sample: Sample) -> None:
        self.samples.append(sample)

    def on_frame(self, processed: ProcessedFrame) -> None:
        self.frames.append(processed)

    def on_decision(self, decision: Decision) -> None:
        self.decisions.append(decision)


_ORDER_AT_STEP = 10


def sim_settings() -> Settings:
    scenario = load_scenario(SCENARIO)
    settings = load("sim")
    return msgspec.structs.replace(
        settings,
        camera=CameraSettings(scenario.camera.file),
        pad=PadSettings(scenario.pad.file),
        estimator=msgspec.structs.replace(settings.estimator, path="dead_reckoning"),
    )


def fly(observers: Sequence[Observer], seconds: float, recorder: Recorder | None = None) -> Flight:
    """Return the first seconds of a flight, with the truth passed to the recorder at 50 Hz."""
    settings = sim_settings()
    pilot = make_pilot(settings, shadows=("median_mean",))
    flight = Flight(load_scenario(SCENARIO), 1, settings, pilot, observers=observers)
    if recorder is not None:
        recorder.watch(flight.health)
    for step in range(round(seconds / 0.005)):
        flight.step()
        if step == _ORDER_AT_STEP:
            for order, detail in ((OperatorOrder.RECORD, "on"), (OperatorOrder.CLEAR, "")):
                pilot.operator.take(order, OrderSender(OrderSource.TERMINAL, "1"), flight.world.now, detail)
        if recorder is not None and step % 4 == 0:
            t = flight.world.truth()
            recorder.on_truth(TruthRecord(int(t.at), t.d_body_pad_level.tolist(), t.v_pad_level.tolist(), t.yaw_rad))
    return flight


def record_to(path: Path, seconds: float = 2.0, **options: object) -> ObservedCalls:
    """Fly, record into `path`, and return the calls that the second observer received."""
    settings, observed = sim_settings(), ObservedCalls()
    pilot = make_pilot(settings)
    with recorder_to_file(path, pilot.camera, about(settings, {"scenario": SCENARIO, "seed": "1"}), **options) as recorder:  # type: ignore[arg-type]
        fly([observed, recorder], seconds, recorder)
    return observed
