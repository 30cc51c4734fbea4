"""Lateness read off a log: hand-worked ticks on a grid, with ticks missed and a rate that jitters."""

from __future__ import annotations

import numpy as np
import pytest

from link.files.grid_lateness import grid_lateness_ms


def test_lateness_on_an_even_grid() -> None:
    ticks = 7.3 + np.arange(2000) / 20.0
    late_s = np.zeros(2000)
    late_s[::100] = 0.004
    assert grid_lateness_ms(ticks + late_s) == pytest.approx(late_s * 1e3, abs=1e-6)


def test_missed_ticks_do_not_add_up() -> None:
    """Every third tick is missed for an hour: what was sent is as late as it was, and no later."""
    index = np.array([k for k in range(72_000) if k % 3])
    late_s = 0.001 * (index % 5)
    measured = grid_lateness_ms(100.0 + index / 20.0 + late_s)
    assert measured.max() == pytest.approx(4.0, abs=1e-3)
    assert float(np.median(measured)) == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.8])
def test_one_setpoint_late_by_much_of_a_period_is_the_only_one_late(share: float) -> None:
    late_s = np.zeros(2000)
    late_s[1000] = share / 20.0
    measured = grid_lateness_ms(7.3 + np.arange(2000) / 20.0 + late_s)
    assert measured == pytest.approx(late_s * 1e3, abs=1e-6)
    assert float(np.quantile(measured, 0.99)) == pytest.approx(0.0, abs=1e-6)


def test_a_late_first_setpoint_does_not_set_the_grid() -> None:
    late_s = np.zeros(500)
    late_s[0] = 0.02
    assert grid_lateness_ms(np.arange(500) / 20.0 + late_s) == pytest.approx(late_s * 1e3, abs=1e-6)


def test_stamps_cut_to_microseconds_are_not_late_by_a_period() -> None:
    ticks = np.floor((1_795_000_000.123456789 + np.arange(5000) / 20.0) * 1e6) / 1e6
    assert grid_lateness_ms(ticks).max() < 0.01


def test_spread_over_a_third_of_the_period_it_is_counted_from_the_most_punctual() -> None:
    late_s = np.random.default_rng(1).uniform(0.0, 0.016, 5000)
    measured = grid_lateness_ms(np.arange(5000) / 20.0 + late_s)
    assert measured == pytest.approx((late_s - late_s.min()) * 1e3, abs=0.05)
