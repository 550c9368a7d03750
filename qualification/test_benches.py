"""Every bench runs to its end in its smallest run, and measures something."""

import pytest

from tests.benches.test_smoke import BENCHES, assert_measures


@pytest.mark.parametrize("bench", BENCHES)
def test_a_bench_runs_to_its_end_in_its_smallest_run(bench, tmp_path, monkeypatch, capsys):
    assert_measures(bench, tmp_path, monkeypatch, capsys)
