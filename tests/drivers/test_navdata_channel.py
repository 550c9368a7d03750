import pytest

from drivers.ardrone import navdata as nd
from drivers.ardrone.counters import Counters
from drivers.ardrone.navdata_channel import NavdataChannel
from drivers.ardrone.options import ArDroneOptions
from drivers.clock import SystemClock
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs

DEMO = nd.Demo(nd.ControlState.HOVERING.word, 50, 0.0, 0.0, 0.0, 0, 0.0, 0.0, 0.0)


class Ear:
    """A channel without a socket: datagrams go in by hand."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.sequences: list[int] = []
        self.restarts = 0
        self.counters = Counters()
        self.channel = NavdataChannel(ArDroneOptions(), SystemClock(), self.counters, self._received, self._restarted)

    def _received(self, navdata: nd.Navdata, samples: list[Sample], received_at: MonoNs) -> None:
        self.sequences.append(navdata.sequence)
        self.samples += samples

    def _restarted(self) -> None:
        self.restarts += 1

    def hears(self, sequence: int, drone_ms: int | None, heard_ms: int) -> None:
        options = (DEMO,) if drone_ms is None else (DEMO, nd.NavdataTime.of_us(drone_ms * 1000))
        self.channel.take(nd.encode(nd.Navdata.of(0, sequence, options)), MonoNs(heard_ms * 1_000_000))


@pytest.fixture
def ear() -> Ear:
    return Ear()


def test_overtaken_and_doubled_datagrams_are_refused(ear: Ear) -> None:
    for k, sequence in enumerate([10, 11, 14, 12, 14, 13, 15]):
        ear.hears(sequence, 5 * sequence, 1000 + 5 * k)
    assert ear.sequences == [10, 11, 14, 15]
    assert (ear.counters.navdata_out_of_order, ear.counters.navdata_lost, ear.restarts) == (3, 2, 0)


@pytest.mark.parametrize(("last", "anew"), [(500, 1), (500, 3), (20, 1)])
def test_a_sequence_that_begins_again_is_a_restart(ear: Ear, last: int, anew: int) -> None:
    ear.hears(last, 60_000, 100_000)
    ear.hears(anew, 59_800, 100_100)  # a small step back of the clock: no restart to be seen in the clock alone
    assert ear.sequences == [last, anew]
    assert (ear.counters.navdata_restarts, ear.restarts) == (1, 1)
    stamp = ear.samples[-1].stamp
    assert stamp.received_at - stamp.measured_at < 5_000_000, "the new clock is not read by the old map"


def test_without_a_clock_the_stamp_reports_it(ear: Ear) -> None:
    ear.hears(1, None, 1000)
    stamp = ear.samples[0].stamp
    assert (stamp.source, stamp.sigma_s) == ("arrival", ArDroneOptions().arrival_sigma_s)
    assert stamp.measured_at < stamp.received_at


def test_bootstrap_has_no_samples_but_is_received(ear: Ear) -> None:
    ear.channel.take(nd.encode(nd.Navdata.of(nd.NavdataState.NAVDATA_BOOTSTRAP, 1)), MonoNs(5))
    assert ear.sequences == [1]
    assert ear.samples == []
    assert ear.channel.received_at == 5
