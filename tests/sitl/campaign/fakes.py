"""A flight that costs nothing, and a program that flies a campaign of them: `python -m tests.sitl.campaign.fakes FOLDER RUNS`."""

import os
import signal
import sys
import time
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

from companion.settings.model import Settings
from sitl.campaign.figures import Tally, added, tallies_of
from sitl.campaign.plan import CampaignPlan, Job, code_version, make_plan, seeds_of
from sitl.campaign.store import FolderStore, fly_left
from sitl.campaign.workers import Flight, LocalWorkers
from sitl.flight.one_flight import Perception
from sitl.scenario.scenario import Scenario
from sitl.scenario.settings import settings_for
from tests.fly import near

RAISES, KILLS = 13, 66
"""Seeds of a flight that raises an error, and of one that kills its process."""


def plan(name: str = "near", **over: object) -> CampaignPlan:
    scenario = near(**over)
    return make_plan(name, scenario, settings_for(scenario, None), "pixels")


def tally_of(flights: Iterable[Flight]) -> Tally:
    return added(tallies_of(flights).values())


def fake_fly(
    name: str, scenario: Scenario, seed: int, settings: Settings, perception: Perception, perception_model: str | None
) -> Flight:
    """Land some centimetres off, more in wind; off the pad beyond its edge.

    The scenario's `start.height_m` is a delay in seconds from 1 m on.
    """
    time.sleep(max(0.0, scenario.start.height_m - 2.0))
    if seed == RAISES:
        raise ValueError("an unlucky number")
    if seed == KILLS:
        os.kill(os.getpid(), signal.SIGKILL)
    lateral_m = round(0.01 * (1 + seed % 7) + 0.06 * scenario.wind.speed_m_s, 4)
    on_pad = lateral_m < 0.39
    why = f"touched the deck {lateral_m:.2f} m from the pad's centre"
    touch = {
        "surface": "pad" if on_pad else "deck",
        "on_pad": on_pad,
        "lateral_m": lateral_m,
        "p_pad_m": [lateral_m, 0.0],
        "yaw_deg": 1.0,
        "vertical_speed_m_s": 0.4,
        "lateral_speed_m_s": 0.02 * (seed % 5),
    }
    return {
        "scenario": name,
        "seed": seed,
        "landed_on_pad": on_pad,
        "outcome": "landed",
        "duration_s": 20.0 + seed % 3,
        "touchdown": touch,
        "contacts": [{**touch, "at_s": 20.0, "phase": "land", "vehicle_phase": "landing", "motors": True}],
        "in_water": False,
        "frames": {"fused": 600},
        "grade": "on pad" if on_pad else "failed",
        "because": "fine" if on_pad else why,
        "expect": "land",
        "refused": None,
        "unsafe": [] if on_pad else [why],
        "lowest_blind_m": None,
        "contacts_outside_commit": 0,
        "faults": [],
        "cpu_s": round(time.process_time(), 3),
    }


def run_campaign(folder: str, runs: str, delay_s: str = "0", workers: str = "2") -> None:
    own = plan(start={"height_m": 2.0 + float(delay_s)})
    seeds = seeds_of(0, int(runs))
    with (
        closing(FolderStore(Path(folder), own, seeds)) as store,
        LocalWorkers(own, code_version(), int(workers), fake_fly) as workforce,
    ):
        fly_left(workforce.results, store, map(Job, seeds), lambda flight: print(flight["seed"], flush=True))


if __name__ == "__main__":
    run_campaign(*sys.argv[1:])
