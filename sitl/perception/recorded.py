"""A recorded flight with its truth, as the error models are fitted to."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from companion.base.observer import Decision
from companion.recording.reading import RecordedFrame, open_recording
from companion.recording.records import TruthRecord
from companion.settings.model import Settings
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import RelativeState
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from sitl.scenario.scenario import Scenario, load


class Recorded(NamedTuple):
    """The content of one recording."""

    path: Path
    scenario: Scenario
    name: str
    """Scenario and seed, as the flight was asked for."""
    settings: Settings
    camera: Camera
    pad: Pad
    truths: dict[int, TruthRecord]
    """True states by instant, ns."""
    frames: tuple[RecordedFrame, ...]
    """The frames in which vision searched, in order."""
    beliefs: tuple[RelativeState, ...]
    """The steering estimate at each guidance cycle that had one, in order."""


def read(path: Path) -> Recorded:
    """Return what a recording of `decklander simulate --record` holds.

    Raises:
        BadInput: it cannot be read, is of another kind, or holds no truth with attitudes; its scenario is gone.
    """
    recording = open_recording([path])
    camera, pad, settings = recording.camera(), recording.pad(), recording.settings()
    facts = recording.metadata.get("flight", {})
    if camera is None or pad is None or settings is None or facts.get("kind") != "simulate":
        raise BadInput(f"{path}: only a recording of decklander simulate knows the truth that a fit needs")
    if (level := facts.get("perception", "pixels")) != "pixels":
        raise BadInput(f"{path}: flown with --perception {level}; a fit needs what the real vision found")
    truths: dict[int, TruthRecord] = {}
    frames: list[RecordedFrame] = []
    beliefs: list[RelativeState] = []
    for event in recording.events():
        match event:
            case TruthRecord():
                truths[event.at_ns] = event
            case RecordedFrame():
                if event.record.tried is not None:
                    frames.append(event)
            case Decision():
                if event.belief is not None:
                    beliefs.append(event.belief)
            case _:
                pass
    if all(truth.R_ned_body is None for truth in truths.values()):
        raise BadInput(f"{path}: holds no true attitudes: record the flight again with this version")
    name = f"{Path(facts['scenario']).stem} {facts['seed']}"
    return Recorded(path, load(facts["scenario"]), name, settings, camera, pad, truths, tuple(frames), tuple(beliefs))
