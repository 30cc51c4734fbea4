"""Lateness read off a log: hand-worked ticks on a grid, with ticks missed and a rate that jitters."""

from __future__ import annotations

import numpy as np
import pytest

from link.report import _lateness_ms


def test_lateness_on_an_even_grid() -> None:
    ticks = 7.3 + np.arange(2000) / 20.0
    late_s = np.zeros(2000)
    late_s[::100] = 0.004
    assert _lateness_ms(ticks + late_s) == pytest.approx(late_s * 1e3, abs=1e-6)


def test_missed_ticks_do_not_add_up() -> None:
    """Every third tick is missed for an hour: what was sent is as late as it was, and no later."""
    index = np.array([k for k in range(72_000) if k % 3])
    late_s = 0.001 * (index % 5)
    measured = _lateness_ms(100.0 + index / 20.0 + late_s)
    assert measured.max() == pytest.approx(4.0, abs=1e-3)
    assert float(np.median(measured)) == pytest.approx(2.0, abs=1e-3)
