"""Benches whose smallest run flies in real time or often run to their end."""

import pytest

from tests.benches.test_smoke import LONG, assert_measures


@pytest.mark.parametrize("bench", LONG)
def test_a_long_bench_runs_to_its_end_in_its_smallest_run(bench, tmp_path, monkeypatch, capsys):
    assert_measures(bench, tmp_path, monkeypatch, capsys)
