"""Train a policy of one's own for some minutes and land by it: `python -m examples.train_and_fly [MINUTES] [FILE]`.

It does by the library what `decklander train` does: worlds, a teacher, a student, and a mission with `controller = "policy"`.
"""

import sys
import time
from pathlib import Path

from msgspec.structs import replace

from companion.settings.load import response_model
from sitl.flight.one_flight import fly
from sitl.scenario.scenario import load
from sitl.scenario.settings import settings_for
from sitl.study.gym.imitation import AS_HANDED_OVER, Imitation
from sitl.study.gym.training import TrainingWorlds


def main(minutes: float, file: Path) -> bool:
    """Train, write the file, and fly once; return whether the drone stands on the pad."""
    scenario = load("weather_3")
    settings = settings_for(scenario, None)
    tilt = response_model(settings).tilt
    worlds = [TrainingWorlds(load(name), 64, AS_HANDED_OVER) for name in ("weather_2", "weather_3", "weather_4")]
    student = Imitation(worlds, response_model(settings), seed=2)
    began = time.monotonic()
    for progress in student.rounds(2000, lambda: (time.monotonic() - began) / (60.0 * minutes)):
        print(f"round {progress.round}: error {progress.error:.3f}, {progress.flown.episodes} episodes flown by itself")
    student.policy({"response": {"delay_s": tilt.delay_s, "frequency_rad_s": tilt.frequency_rad_s}}).write(file)
    guidance = replace(settings.guidance, controller="policy", policy_file=str(file))
    flight = fly("weather_3", scenario, 3, replace(settings, guidance=guidance), "model").as_json()
    print(f"{flight['outcome']}: {flight['because']}")
    return bool(flight["landed_on_pad"])


if __name__ == "__main__":
    sys.exit(0 if main(float(sys.argv[1]) if len(sys.argv) > 1 else 3.0, Path((sys.argv[2:] or ["mine.npz"])[0])) else 1)
