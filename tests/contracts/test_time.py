import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.contracts.time import MonoNs, Stamp, after, seconds_between

instants = st.integers(0, 10**15).map(MonoNs)


@given(instants, st.integers(-(10**6), 10**6))
def test_after_and_between_are_inverse(t, ms):
    later = after(t, ms / 1e3)
    assert later == t + ms * 1_000_000
    assert seconds_between(t, later) == ms / 1e3
    assert seconds_between(later, t) == -ms / 1e3


@given(instants, st.integers(0, 10**9))
def test_a_stamp_knows_its_delay(t, delay_ns):
    assert Stamp(t, MonoNs(t + delay_ns), 0.0, "hw").delay_s == pytest.approx(delay_ns * 1e-9)


@pytest.mark.parametrize("sigma", [-1e-9, 1.0, 2.0, float("nan"), float("inf")])
def test_an_absurd_uncertainty_is_refused(sigma):
    with pytest.raises(ValueError, match="sigma"):
        Stamp(MonoNs(0), MonoNs(0), sigma, "hw")


def test_a_sample_may_be_early_within_five_sigma_and_no_more():
    assert Stamp(MonoNs(5_000_000), MonoNs(0), 0.001, "synced").delay_s == -0.005
    with pytest.raises(ValueError, match="arrive before"):
        Stamp(MonoNs(5_000_001), MonoNs(0), 0.001, "synced")
